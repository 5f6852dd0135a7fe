"""Whether a shape survives the sewing: the error of copies whose muscles, pressures and cloth differ as built ones do
(studies/layouts/scatter.py).

The shape's derivatives give the error of any number of copies without another simulation, where they hold; a batch of
true copies confirms it. Near a fold they do not: there copies stand in their place.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from fabdesign.formats.schema import Key, Millimetre
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.predictor import Predictor
from fabdesign.study_files.study_targets import Robust
from fabdesign.units import in_mm
from optimize.search.local_search import LinearShape
from optimize.search.objective import Poses
from optimize.search.starts import Start
from studies.layouts.scatter import Scatter, Scattering
from studies.prediction.stability import copies_elsewhere

PROBES = 8  # true copies on the coarse model by which derivatives are checked; so many cost no more than one
FOLD_COPIES = 24  # true copies on the coarse model in place of derivatives
HOLDS = 1.5  # factor by which the mean error of copies and that by derivatives may differ
OFF = 0.003  # m that a muscle lies off its place when the most delicate one is looked for
YIELD_OVER = 0.25  # of the nominal value, within which a copy counts where the study states no tolerance


@dataclass(frozen=True, eq=False)
class Robustness:
    """The robustness of one layout, in m of the searched measure. `copies` are true ones.

    expected_linear, yield_linear: by derivatives; holds: whether these agree with the copies. yielded: share within
    `tolerance`. on_another_branch: copies of another stable shape, or diverged. band: (2 n,) m that the points of the
    first pose move by, standard deviation. delicate: the muscle, from 0, and the value with it 3 mm off. doubled: how
    often one of its muscles was laid as two. chosen_for: the measure by which the study chooses.
    """

    nominal: Annotated[Millimetre, Key("nominal_mm")]
    expected_linear: Annotated[Millimetre, Key("first_order.expected_mm")]
    yield_linear: Annotated[float, Key("first_order.yield")]
    holds: Annotated[bool, Key("first_order.holds")]
    tolerance: Annotated[Millimetre, Key("tolerance_mm")]
    expected: Annotated[Millimetre, Key("expected_mm")]
    yielded: Annotated[float, Key("yield")]
    worst: Annotated[Millimetre, Key("worst_mm")]
    on_another_branch: Annotated[int, Key("elsewhere")]
    shapes: tuple[Poses, ...]
    band: Array
    delicate: tuple[int, float]
    chosen_for: str
    doubled: int = 0
    json_keys: ClassVar = (
        "nominal", "expected", "worst", "yielded", "tolerance", "copies", "on_another_branch", "expected_linear",
        "yield_linear", "holds",
        ("band_mm", lambda of: {"mean": float(of.band.mean()), "largest": float(of.band.max())}),
        ("delicate", lambda of: {"muscle": of.delicate[0], "off_mm": in_mm(OFF), "value_mm": in_mm(of.delicate[1])}),
        "doubled", "chosen_for", ("said", "sentences"),
    )  # fmt: skip

    @property
    def copies(self) -> int:
        return len(self.shapes)

    @property
    def sentences(self) -> list[str]:
        """Return sentences for people."""
        band, (muscle, value) = self.band, self.delicate
        lines = [
            f"{self.copies} copies with the scatter of building were simulated. {self.yielded:.0%} of them are "
            f"within {in_mm(self.tolerance):.2f} mm of the target. Mean {in_mm(self.expected):.2f} mm, worst "
            f"{in_mm(self.worst):.2f} mm; without scatter {in_mm(self.nominal):.2f} mm.",
            f"The standard deviation of a point's place is {in_mm(band.mean()):.1f} mm in the mean and "
            f"{in_mm(band.max()):.1f} mm at most.",
            f"Muscle {muscle} matters most: {in_mm(OFF):.0f} mm off its place it gives {in_mm(value):.2f} mm.",
        ]
        if self.doubled:
            times = "once" if self.doubled == 1 else f"{self.doubled} times"
            lines.append(
                f"A muscle was laid as two beside each other at less pressure, {times}: their errors are independent "
                "and average out."
            )
        if not self.holds:
            lines.append(
                "The derivatives are not valid here, as near a bifurcation: they give "
                f"{in_mm(self.expected_linear):.2f} mm. The values above are those of the copies."
            )
        if self.on_another_branch:
            lines.append(
                f"{self.on_another_branch} copies come to another stable shape, or to none: the layout is near a "
                "bifurcation."
            )
        return lines


def first_order(scatter: Scatter, model: LinearShape, tolerance: float) -> tuple[float, float]:
    """Return the expected value [m] and yield, by derivatives."""
    return mean_and_yield(_linear_values(scatter, model, scatter.normals()), tolerance)


def _linear_values(scatter: Scatter, model: LinearShape, zs: Array) -> list[float]:
    return scatter.how.objective.values([model.at(z) for z in zs])


def mean_and_yield(values: Sequence[float], tolerance: float) -> tuple[float, float]:
    """Return m and a share; infinite m where a copy diverged."""
    return float(np.mean(values)), float((np.array(values) <= tolerance).mean())


def _holds(linear_values: Sequence[float], values: Sequence[float]) -> bool:
    """Return whether derivatives say of copies what these show, in the mean; never where a copy diverged."""
    one, other = (float(np.mean(each)) for each in (linear_values, values))
    return bool(one < HOLDS * other and other < HOLDS * one)


def tolerance_of(robust: Robust, nominal: float) -> float:
    """Return m of the objective within which a copy counts for the yield; nominal: m, of the search's result."""
    return robust.tolerance if robust.tolerance is not None else (1 + YIELD_OVER) * nominal


def most_robust(how: Scattering, points: Sequence[Start]) -> int:
    """Return the number of the layout that the study would choose of several near ones: by derivatives, or by true
    copies where these do not hold."""
    scored, tolerance = [], None
    for k, (space, x) in enumerate(points):
        scatter = Scatter(how, *space.decode(x))
        model, definite = scatter.linear()
        if not np.isfinite(model.shape).all():
            continue
        if tolerance is None:
            tolerance = tolerance_of(how.robust, how.objective.value(model.shape))
        expected, share = _expected(scatter, model if definite else None, tolerance)
        scored.append(((-share, expected) if how.robust.choose == "yield" else (expected, -share), k))
    return min(scored)[1] if scored else 0


def _expected(scatter: Scatter, model: LinearShape | None, tolerance: float) -> tuple[float, float]:
    """Return the expected value [m] and yield: by derivatives, where there are some, while a few copies agree with
    them, else by more copies."""
    zs, values = scatter.normals(), list[float]()
    if model is not None:
        values = scatter.values(zs[:PROBES])
        if _holds(_linear_values(scatter, model, zs[:PROBES]), values):
            return first_order(scatter, model, tolerance)
    return mean_and_yield([*values, *scatter.values(zs[len(values) : FOLD_COPIES])], tolerance)


def robustness_of(how: Scattering, result: tuple[Design, Array], fine: Predictor, *, nominal: float) -> Robustness:
    """Return how robust a result is. fine: of the true copies; all else is of the coarse model. nominal: m, of the
    search's nearest result, which the tolerance is counted from where the study states none."""
    robust, objective, scatter = how.robust, how.objective, Scatter(how, *result)
    tolerance = tolerance_of(robust, nominal)
    model, definite = scatter.linear()
    expected, share = first_order(scatter, model, tolerance)
    zs = np.random.default_rng(how.study.seed + 1).standard_normal((robust.copies, scatter.size))
    centre, *shapes = Scatter(replace(how, forward=fine), *result).shapes([np.zeros(scatter.size), *zs])
    values = objective.values(shapes)
    sound = [shape for shape in shapes if np.isfinite(shape).all()]
    moved = np.array([shape[0] - centre[0] for shape in sound]) if sound else np.zeros((1, *centre[0].shape))
    holds = definite and _holds(_linear_values(scatter, model, zs), values)
    return Robustness(
        nominal=objective.value(centre),
        expected_linear=expected,
        yield_linear=share,
        holds=holds,
        tolerance=tolerance,
        expected=float(np.mean([value for value in values if value < np.inf])) if sound else float("inf"),
        yielded=mean_and_yield(values, tolerance)[1],
        worst=max(values),
        on_another_branch=copies_elsewhere(shapes, [model.at(z) - model.shape for z in zs] if holds else None, centre),
        shapes=tuple(sound),
        band=np.sqrt(np.square(moved).sum(axis=2).mean(axis=0)),
        delicate=_most_delicate(scatter, model if holds else None),
        chosen_for=robust.choose,
    )


def _most_delicate(scatter: Scatter, model: LinearShape | None) -> tuple[int, float]:
    """Return the muscle whose worst of four directions is worst, and its value; by derivatives, or without a model by
    shapes."""
    directions, muscles = ((1, 0), (-1, 0), (0, 1), (0, -1)), len(scatter.design.muscles)
    zs = np.array([scatter.shifted(k, direction, OFF) for k in range(muscles) for direction in directions])
    values = scatter.values(zs) if model is None else _linear_values(scatter, model, zs)
    worst = np.reshape(values, (muscles, len(directions))).max(axis=1)
    return int(np.argmax(worst)), float(np.max(worst))
