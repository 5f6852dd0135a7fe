"""The reach of a search: how far over the floor, what holds it back, whether the shape can be; and of a target that is
out of reach where the nearest shape misses it, and what would bring it nearer."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.spatial import KDTree

from fabdesign.geometry.metrics import Errors
from fabdesign.geometry.shape import Shape
from fabdesign.geometry.surface import pierced
from fabdesign.nouns.array import Array
from fabdesign.nouns.column import factor
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.pressure import LARGEST
from fabdesign.runtime.effort import duration
from fabdesign.study_files.study_file import Study
from fabdesign.units import in_kpa, in_mm
from optimize.search.design_space import DesignSpace
from optimize.search.evaluations import Evaluations
from optimize.search.multistart import evaluations_to_converge, has_converged
from optimize.search.objective import MEASURES, Objective
from optimize.search.slopes import jacobians_for, what_helps
from optimize.search.starts import Start
from studies.layout_search.target import LoadedTarget, is_wished

AREA = 0.15  # of the cloth's sides, over which a distance is averaged: single points are noise
BY = 0.2  # of a declared value
WIDER = 0.1  # of the pressure range
WORTH = 0.02  # of the objective, under which a change is not worth a word
SHOWN = 3
CHANGED_FACTORS = {
    "membrane": "membrane stiffness",
    "shear": "shear stiffness",
    "bending": "bending stiffness",
    "areal_density": "areal density of the cloth",
    "muscle_gain": "pull of the muscles at the same pressure",
    "axis_offset": "distance of the muscles' axes from the cloth",
}


@dataclass(frozen=True)
class Missed:
    """Where a shape lies farthest from its target. place: (u, v) m; off: m, mean distance around it."""

    place: tuple[float, float]
    off: float
    json_keys: ClassVar = ("u", lambda of: of.place[0]), ("v", lambda of: of.place[1]), ("off_mm", "off")


def missed_at(shape: Array, target: LoadedTarget, size: tuple[float, float]) -> Missed:
    """Return where one pose misses: shape (2 n, 3) m beside its target, both ways, of wishes the one that lies farthest
    off; size: (width, height) m of the cloth."""
    if target.landmarks is not None:
        off = target.landmarks.distances(shape)
        worst = int(np.argmax(off))
        u, v = (target.landmarks.shares[worst] * size).tolist()
        return Missed((u, v), float(off[worst]))
    middle = Shape.of(shape).middle  # (rows, columns, 3)
    rows, columns = middle.shape[:2]
    points = middle.reshape(-1, 3)
    to_cloth, nearest = KDTree(points).query(target.points)
    both = np.zeros(len(points)) if target.markers else KDTree(target.points).query(points)[0]
    np.maximum.at(both, nearest, to_cloth)
    window = tuple(max(1, round(AREA * n)) for n in (rows, columns))
    smooth = uniform_filter(both.reshape(rows, columns), window, mode="nearest")
    row, column = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
    place = column / (columns - 1) * size[0], row / (rows - 1) * size[1]
    return Missed((float(place[0]), float(place[1])), float(smooth[row, column]))


def helps_of(study: Study, point: Start, objective: Objective, forward: ForwardModel) -> dict[str, float] | None:
    """Return what helps a result, and what it gains [m of the objective, to first order], most first; None where the
    forward model has no derivatives, or the targets are frames too early for them."""
    jacobians = jacobians_for(forward, objective)
    if jacobians is None:
        return None
    changes = {
        f"{BY:.0%} {'more' if sign > 0 else 'less'} {what}": (factor(name), sign * BY)
        for name, what in CHANGED_FACTORS.items()
        for sign in (1, -1)
    }
    before, nearer = what_helps(jacobians, objective, point, changes, _wider(study, point[0]), spaces_by_type(point[0]))
    return {what: before - value for what, value in nearer.items() if before - value > WORTH * before}


def _wider(study: Study, space: DesignSpace) -> dict[str, DesignSpace]:
    """Return the space with one limit wider, by what that is."""
    limits = space.limits
    low, high = limits.pressure
    spaces: dict[str, DesignSpace] = {}
    most = min((kind.max_pressure or LARGEST for kind in study.design.muscle_types.values()), default=LARGEST)
    highest = high + WIDER * (high - low)
    if space.vary_pressures and highest <= most:
        spaces[f"pressures up to {in_kpa(highest):.0f} kPa"] = replace(
            space, limits=replace(limits, pressure=(low, highest))
        )
    if space.vary_positions:
        spaces["half the spacing"] = replace(space, limits=replace(limits, spacing=limits.spacing / 2))
    return spaces


def spaces_by_type(space: DesignSpace) -> dict[str, DesignSpace]:
    """Return the space with all muscles of one type, of those that the design has besides."""
    muscles = space.design.muscles
    spaces = {}
    for name in space.design.muscle_types:
        if any(muscle.type != name for muscle in muscles):
            changed = tuple(replace(muscle, type=name) for muscle in muscles)
            spaces[f"muscles of type {name}"] = replace(space, design=replace(space.design, muscles=changed))
    return spaces


LEAST_GAP = 1e-3  # m over the floor from which noise does not explain it,
GAP = 0.25  # and at least this share of the floor
AT_LIMIT = 0.01  # of the pressure range
TOUCHING = 2e-4  # m of a limit's margin
TOUCHING_SHARE = 2e-3  # of contraction, and of the air


@dataclass(frozen=True)
class Lacking:
    """About what a search that ended before it converged still needs; None where nothing says it."""

    evaluations: int | None
    seconds: float | None  # at the pace that it had

    @property
    def sentence(self) -> str:
        if self.evaluations is None or self.seconds is None:
            return "More time may bring it nearer; how much is not known before a first restart has ended."
        return (
            f"To converge it may need about {_rounded(self.evaluations)} evaluations more, about "
            f"{duration(_rounded(self.seconds))} at its pace so far."
        )


def _rounded(value: float) -> int:
    """Return a guess with two digits at most, and not less than 1."""
    return max(1, int(float(f"{value:.1e}")))


def lacking_of(evaluations: Evaluations) -> Lacking | None:
    """Return None of a search that has converged."""
    if has_converged(evaluations):
        return None
    more, done = evaluations_to_converge(evaluations), evaluations.history.evaluations
    return Lacking(more, None if more is None else more * evaluations.elapsed / max(done, 1))


@dataclass(frozen=True)
class Reach:
    """gap: m, of the searched measure over its floor. out_of_reach: so much that noise does not explain it; None, not
    known, of a search that has not converged. held_by: what the result has come up against, a clause each. crossing:
    (u, v) m where the cloth passes through itself, a pose each, None where it does not. lacking: of a search that has
    not converged. missed: a pose each, and helps (m by what would gain them), where it is out
    of reach. wished: wishes without noise."""

    gap: float
    beyond_noise: bool
    held_by: tuple[str, ...]
    crossing: tuple[tuple[float, float] | None, ...]
    lacking: Lacking | None = None
    missed: tuple[Missed, ...] = ()
    helps: dict[str, float] | None = None
    wished: bool = False
    json_keys: ClassVar = (
        ("gap_mm", "gap"), "out_of_reach", ("converged", lambda of: of.lacking is None),
        ("needs", lambda of: of.lacking if of.lacking and of.lacking.evaluations else None),
        "held_by", "passes_through_itself", "missed", ("helps", "gains"), ("said", "sentences"),
    )  # fmt: skip

    @property
    def out_of_reach(self) -> bool | None:
        return None if self.beyond_noise and self.lacking else self.beyond_noise

    @property
    def passes_through_itself(self) -> bool:
        return any(place is not None for place in self.crossing)

    @property
    def gains(self) -> list[dict[str, Any]] | None:
        """Return a row for each change that helps."""
        helps = self.helps
        return None if helps is None else [{"what": k, "gain_mm": in_mm(gain)} for k, gain in helps.items()]

    @property
    def sentences(self) -> list[str]:
        lines, over = [], "from what was asked for" if self.wished else "over the noise floor"
        if self.out_of_reach:
            if self.held_by:
                lines.append(
                    f"Out of reach: {in_mm(self.gap):.1f} mm {over}. What holds it back: {', '.join(self.held_by)}."
                )
            else:  # then it may be the search that stood still
                lines.append(
                    f"Not reached: {in_mm(self.gap):.1f} mm {over}, though no limit holds it back. "
                    "Another seed, number of muscles or kind of layout may come nearer."
                )
            for pose, miss in enumerate(self.missed, start=1):
                of, where = f" in pose {pose}" if len(self.missed) > 1 else "", _around(miss.place)
                lines.append(f"It misses the target most{of} {where}: {in_mm(miss.off):.1f} mm.")
            if self.gains is not None:
                gains = [f"{gain['what']}: {gain['gain_mm']:.1f} mm" for gain in self.gains[:SHOWN]]
                none = f"By derivatives no limit or constant that is changed by {BY:.0%} gains {WORTH:.0%}."
                lines.append(f"What would bring it nearer, by derivatives: {'; '.join(gains)}." if gains else none)
        elif self.lacking:
            gap = f", {in_mm(self.gap):.1f} mm {over}" if self.beyond_noise else ""
            lines.append(f"The search ended before it converged{gap}. {self.lacking.sentence}")
            if self.beyond_noise and self.held_by:
                lines.append(f"So far it has come up against: {', '.join(self.held_by)}.")
        for pose, place in enumerate(self.crossing, start=1):
            if place is not None:
                of = f" of pose {pose}" if len(self.crossing) > 1 else ""
                lines.append(f"No real cloth takes this shape{of}: it passes through itself {_around(place)}.")
        return lines


def _around(place: tuple[float, float]) -> str:
    return f"around u {in_mm(place[0]):.0f}, v {in_mm(place[1]):.0f} mm"


def reach_of(
    study: Study,
    design: Design,
    pressures: Array,
    shapes: Array,
    errors: Errors,
    margins: Mapping[str, float],
    lacking: Lacking | None = None,
) -> Reach:
    """Return the reach. pressures (poses, channels) Pa, shapes (poses, 2 n, 3) m and `margins` (`constraint_margins`)
    of the result."""
    value, floor = MEASURES[study.objective].errors(errors)
    size = design.fabric.width, design.fabric.height
    places = [pierced(shape) for shape in shapes]
    return Reach(
        gap=value - floor,
        beyond_noise=value - floor > max(LEAST_GAP, GAP * floor),
        held_by=tuple(_held_by(study, design, pressures, margins)),
        lacking=lacking,
        wished=is_wished(study.targets),
        crossing=tuple(None if p is None else (float(p[0] * size[0]), float(p[1] * size[1])) for p in places),
    )


def _held_by(study: Study, design: Design, pressures: Array, margins: Mapping[str, float]) -> Sequence[str]:
    low, high = study.limits.pressure
    acting = pressures[:, [muscle.channel for muscle in design.muscles]]
    at_most = (acting > high - AT_LIMIT * (high - low)).any(axis=0).sum()
    held = []
    if study.pressures and at_most:
        count = "all muscles" if at_most == acting.shape[1] else f"{at_most} of {acting.shape[1]} muscles"
        held.append(f"{count} at {in_kpa(high):g} kPa")
    if study.muscles is not None and len(design.muscles) == study.muscles.most:
        held.append("the one muscle used" if study.muscles.most == 1 else f"all {study.muscles.most} muscles used")
    if study.positions:
        held += [
            f"{name.replace('_', ' ')} at its limit"
            for name in ("spacing", "stock_length", "min_bend_radius")
            if margins.get(name, np.inf) < TOUCHING
        ]
    if margins.get("contraction", np.inf) < TOUCHING_SHARE:
        held.append("contraction at its limit")
    if study.limits.air is not None and margins.get("air", np.inf) < TOUCHING_SHARE * study.limits.air:
        held.append("air at its limit")
    if study.muscles is not None and study.limits.channels == design.channels < len(design.muscles):
        held.append("the one channel used" if design.channels == 1 else f"all {design.channels} channels used")
    return held
