"""The field corrector, a displacement of the ordered points, in numpy; what it learns from, measured heights, their
errors, and what each basis function would do; and the coefficients: ridge regression on many trials at once, in closed
form. And the corrector of a model, loaded from its file."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save
from scipy.ndimage import uniform_filter

from corrector.basis import Basis, every_function
from corrector.inputs import HISTORY, described, distance, fields_of
from corrector.shape import FINE, LocalFrames, displaced
from fabdesign.errors import InputError
from fabdesign.geometry.shape import Shape
from fabdesign.geometry.surface import Surface, front_triangles
from fabdesign.nouns.array import Array, Floats
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, Corrector, Trust, with_history
from fabdesign.nouns.model import Model
from fabdesign.output import atomic_file
from fabdesign.units import in_mm

FAMILIAR = 0.2  # distance over which a design stops being one of those learned from


@dataclass(frozen=True, eq=False)
class FieldCorrector:
    """Implements fabdesign.nouns.forward.Corrector. `known`: the designs it learned from (`designs.described`)."""

    seen: NDArray[np.float64]  # (K,) coefficients of the basis functions, for layouts learned from
    unseen: NDArray[np.float64]  # (K,) for others
    known: Sequence[Mapping[str, Any]]
    limit: float  # of trust
    ordered: bool = True
    starts: float = 0.0

    def history(self) -> tuple[float, ...]:
        return HISTORY

    def trust(self, design: Design) -> Trust:
        return Trust(distance(described(design), self.known), self.limit)

    def correct(
        self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]], motions: Sequence[Floats]
    ) -> list[NDArray[np.float32]]:
        """See fabdesign.nouns.forward.Corrector."""
        return [self._correct(*one) for one in zip(cases, times, motions, strict=True)]

    def _correct(self, case: Case, times: NDArray[np.float64], motion: Floats) -> NDArray[np.float32]:
        _, where = with_history(times, HISTORY)
        fabric, trust = case.design.fabric, self.trust(case.design)
        answer = np.array(motion[where[0]], dtype=np.float32)
        sound = np.isfinite(motion[where]).all(axis=(0, 2, 3))
        if trust.applies and sound.any():
            seen = motion[where[:, sound]]
            frames = LocalFrames.of(Shape(seen[0]).middle.astype(np.float32), fabric.width, fabric.height, FINE)
            basis = Basis.of(fields_of(case, times[sound], seen))
            moved = basis.displacement(self.coefficients(trust.distance), frames, case)
            answer[sound] = displaced(answer[sound], moved, fabric.thickness)
        return answer

    def coefficients(self, distance: float) -> NDArray[np.float64]:
        """Return (K,) for a design so far from those learned from."""
        nearness = max(1 - distance / FAMILIAR, 0.0)
        return nearness * self.seen + (1 - nearness) * self.unseen


_WIDTHS = (5, 5, 5, 3, 3, 3)  # nodes, of the squares over which a round takes its means: wide as long as faces mix
_SOFTNESS = (0.7e-3, 0.7e-3, 0.7e-3, 0.5e-3, 0.5e-3, 0.5e-3)  # m: how sharply a point is taken for one face's
_FAR_OFF = (5e-3, 5e-3, 3e-3, 3e-3, 3e-3, 3e-3)  # m: points farther off are strays


def offsets(middle: Floats, cloud: Floats, thickness: float, nodes: int = FINE) -> tuple[Floats, Floats]:
    """Return (nodes, nodes) m from the mid-surface (side, side, 3) to the measured cloth, along its normal, and on how
    many points of the cloud (n, 3) each is the mean; 0 where there is none.

    A point does not say on which face it is: two faces 2 mm apart and 2 mm of error look alike, point by point. Around
    a node they are two layers a thickness apart; expectation-maximisation over the two, from the mean of both, tells
    them apart, as `geometry.sensor_noise` does without a model. A point beyond a hem counts by its height alone.
    """
    height, row, col = _heights(np.asarray(middle, dtype=np.float64), cloud)
    every = (middle.shape[0] - 1) // (nodes - 1)
    index = np.rint(row / every).astype(np.intp) * nodes + np.rint(col / every).astype(np.intp)
    half = thickness / 2

    def mean(value: Floats, weight: Floats, width: int) -> tuple[Floats, Floats]:
        total, count = (np.bincount(index, x, nodes * nodes).reshape(nodes, nodes) for x in (value * weight, weight))
        if width > 1:
            total, count = (uniform_filter(x, width, mode="constant") for x in (total, count))
        return np.asarray(total / np.maximum(count, 1e-9)), np.asarray(count)

    weight, face = np.ones(len(height)), np.zeros(len(height))
    offset, _ = mean(height, weight, _WIDTHS[0])
    for width, softness, far in zip(_WIDTHS, _SOFTNESS, _FAR_OFF, strict=True):
        off = height - offset.ravel()[index]
        weight = (np.abs(off) < far).astype(np.float64)
        face = np.tanh(off * half / softness**2)
        offset, _ = mean(height - half * face, weight, width)
    return mean(height - half * face, weight, 1)


def _heights(middle: Floats, cloud: Floats) -> Array:
    """Return (3, n): height [m] over the nearest triangle's plane, and row and column of the nearest place."""
    side = middle.shape[0]
    triangles = front_triangles(side, side)
    surface = Surface(middle.reshape(-1, 3).astype(np.float64), triangles)
    nearest = surface.nearest(cloud)
    corners = triangles[nearest.triangle]
    place = np.einsum("nc,ncd->nd", nearest.weights, surface.vertices[corners])
    height = np.einsum("nd,nd->n", cloud - place, surface.normals_of(nearest.triangle))
    rows, cols = np.divmod(corners, side)
    return np.stack([height, (nearest.weights * rows).sum(axis=1), (nearest.weights * cols).sum(axis=1)])


_MOST = 8.0  # points, more of which do not make a node count more: its error is the model's then
_FAR = 20.0  # mm, of which a node is off at most: strays do not decide
_GOOD = 1.0  # mm RMS: a frame that was this near already does not count more


@dataclass(frozen=True, eq=False)
class Examples:
    """Frames of one trial, FINE x FINE nodes in a row."""

    heights: NDArray[np.float16]  # (T, K, N) mm along the normal of a unit coefficient of each basis function
    goal: NDArray[np.float32]  # (T, N) mm from the simulated cloth to the measured one
    weight: NDArray[np.float32]  # (T, N), sum 1 in a frame

    @staticmethod
    def of(
        case: Case, times: Array, motion: NDArray[np.floating], clouds: Sequence[NDArray[np.floating]]
    ) -> "Examples":
        """Return one trial's frames at `times` (T,) s. motion: (U, 2 side^2, 3) m at `with_history(times, HISTORY)`;
        clouds: T of (n, 3) m."""
        _, where = with_history(times, HISTORY)
        fabric = case.design.fabric
        middle = Shape(motion[where[0]]).middle.astype(np.float32)
        frames = LocalFrames.of(middle, fabric.width, fabric.height, FINE)
        heights = in_mm(Basis.of(fields_of(case, times, motion[where])).heights(frames, case))
        pairs = [offsets(frame, cloud, fabric.thickness) for frame, cloud in zip(middle, clouds, strict=True)]
        goal, count = (np.array(x).reshape(len(times), -1) for x in zip(*pairs, strict=True))
        weight = np.minimum(count, _MOST)
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1)
        flat = heights.reshape(*heights.shape[:2], -1)
        goal = np.clip(in_mm(goal), -_FAR, _FAR)
        return Examples(flat.astype(np.float16), goal.astype(np.float32), weight.astype(np.float32))

    def errors(self, coefficients: Floats | None = None) -> Array:
        """Return (T,) mm RMS that is left with these coefficients (K,); by default without any."""
        remainder = self.goal
        if coefficients is not None:
            heights = self.heights.astype(np.float32)
            remainder = remainder - np.einsum("tkn,k->tn", heights, coefficients.astype(np.float32))
        return np.asarray(np.sqrt((remainder**2 * self.weight).sum(axis=1)), dtype=np.float64)

    @cached_property
    def equations(self) -> tuple[Array, Array]:
        """Return (K, K) and (K,): normal equations of all frames, each by its error before."""
        matrix, right = 0.0, 0.0
        for heights, goal, weight, error in zip(self.heights, self.goal, self.weight, self.errors(), strict=True):
            single = heights.astype(np.float32)
            by = single * weight / max(error, _GOOD) ** 2
            matrix, right = matrix + by @ single.T, right + by @ goal
        return np.asarray(matrix, dtype=np.float64), np.asarray(right, dtype=np.float64)


@dataclass(frozen=True)
class Regression:
    """How the field corrector is trained: what is tried, and chosen from on trials and layouts left out."""

    # of a coefficient's square, where its function makes 1 mm RMS
    penalties: tuple[float, ...] = (1e-3, 3e-3, 1e-2, 3e-2, 1e-1)
    shares: tuple[float, ...] = (1.0, 0.75, 0.5, 0.25)  # of the correction, for layouts not learned from
    folds: int = 6
    seed: int = 0


def coefficients_of(
    examples: Sequence[Examples], penalty: float, least: Array, columns: NDArray[np.bool_] | None = None
) -> Array:
    """Return (K,) coefficients, zero outside `columns`, that leave least of the examples' errors, relative to those
    before.

    The penalty is on what a function does, not on its unit: a coefficient counts by the RMS of the heights that it
    makes, as a share of the error before, and by `least` (K,) at least: what moves the cloth in its plane hardly shows
    in heights, and must not grow for that.
    """
    matrix, right = (np.sum([e.equations[i] for e in examples], axis=0) for i in (0, 1))
    frames = sum(len(e.goal) for e in examples)
    result = np.zeros(len(right))
    kept = np.flatnonzero(np.ones(len(right), dtype=bool) if columns is None else columns)
    size = np.maximum(np.sqrt(np.diag(matrix) / frames), least)[kept]
    scaled = matrix[np.ix_(kept, kept)] / np.outer(size, size) + penalty * frames * np.eye(len(kept))
    result[kept] = np.linalg.solve(scaled, right[kept] / size) / size
    return result


def errors_of(examples: Sequence[Examples], coefficients: Array | None = None) -> Array:
    """Return (frames of all,) mm RMS over the nodes of how far the cloth is off along its normal."""
    return np.concatenate([e.errors(coefficients) for e in examples])


def relative_error(examples: Sequence[Examples], coefficients: Array) -> float:
    """Return what is left of the errors before, mean over frames."""
    return float(np.mean(errors_of(examples, coefficients) / np.maximum(errors_of(examples), 0.5)))


def best_penalty(examples: Sequence[Examples], folds: Sequence[Sequence[int]], plan: Regression, least: Array) -> float:
    """Return the penalty that leaves least of trials not learned from; `folds`: indices of those kept back in turn. The
    largest where there is nothing to try it on."""
    if not folds:
        return plan.penalties[-1]
    remaining = np.zeros(len(plan.penalties))
    for kept_back in folds:
        rest = [e for i, e in enumerate(examples) if i not in set(kept_back)]
        held_out = [examples[i] for i in kept_back]
        for k, penalty in enumerate(plan.penalties):
            remaining[k] += len(held_out) * relative_error(held_out, coefficients_of(rest, penalty, least))
    return plan.penalties[int(remaining.argmin())]


FORMAT = "fabdesign.corrector/1"
_KEY = "fabdesign"


def write_weights(path: Path, weights: Mapping[str, NDArray[np.float32]], about: Mapping[str, Any]) -> None:
    """Write arrays by name and what is to be known about them (JSON), whole."""
    content = json.dumps({"format": FORMAT} | dict(about), allow_nan=False)
    with atomic_file(path) as temporary:
        temporary.write_bytes(save({k: np.ascontiguousarray(v) for k, v in weights.items()}, {_KEY: content}))


def read_weights(path: Path) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Return the arrays and what is known about them. Raises InputError for a file that is not there or not a
    corrector's."""
    try:
        with safe_open(path, framework="numpy") as stream:
            about = json.loads((stream.metadata() or {}).get(_KEY, "{}"))
            weights = {name: stream.get_tensor(name) for name in stream.keys()}  # noqa: SIM118 it is no dict
    except (OSError, SafetensorError, ValueError) as error:
        raise InputError(f"{path}: no weights of a corrector can be read ({error})") from None
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        given = about.get("format") if isinstance(about, dict) else None
        raise InputError(f"{path}: format {given}; expected {FORMAT}")
    for name, array in weights.items():
        if not np.isfinite(array).all():
            raise InputError(f"{path}: {name} holds values that are not finite")
    return weights, about


def load_corrector(model: Model) -> Corrector:
    """Return the corrector that a model names. Raises InputError for a file that is none, and for a model whose
    parameters or effects are no longer those that it was trained on."""
    path = model.corrector
    if path is None:
        raise ValueError("the model names no corrector")
    weights, about = read_weights(path)
    if about.get("trained_on") != model.central_hash:
        raise InputError(
            f"{path}: trained on other parameters or effects than the model has; expected those it was trained on "
            "(train again, or take [corrector] out of the model)"
        )
    try:
        if about["network"] == "field":
            if list(about["sources"]) != list(every_function().names):
                raise ValueError("other basis functions than this version has; train again")
            seen, unseen = (weights[name].astype(np.float64) for name in ("seen", "unseen"))
            return FieldCorrector(seen, unseen, list(about["known"]), float(about["trust_limit"]))
        if about["network"] == "paper":
            from corrector.paper import PaperCorrector  # here: it loads PyTorch

            return PaperCorrector.of(weights, about)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{path}: not weights that this version reads ({type(error).__name__}: {error})") from None
    raise InputError(f"{path}: network {about['network']}; expected field or paper")
