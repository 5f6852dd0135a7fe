"""What the field corrector learns from: frames of a trial, their errors, and what each basis function would do."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from corrector.basis import Basis
from corrector.inputs import HISTORY, MuscleFields, fields_of
from corrector.matching import offsets
from corrector.outputs import heights_of
from corrector.response import weight_over_stiffness
from corrector.shape import FINE, LocalFrames, middle_of
from fabdesign.corrector import with_history
from fabdesign.forward import Case
from fabdesign.output import whole_file

Floats = NDArray[np.floating]
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
        case: Case, layout: MuscleFields, times: NDArray[np.float64], motion: NDArray[np.floating], clouds: Sequence
    ) -> "Examples":
        """One trial's frames at `times` (T,) s. motion: (U, 2 side^2, 3) m at `with_history(times, HISTORY)`; clouds:
        T of (n, 3) m."""
        _, where = with_history(times, HISTORY)
        fabric = case.design.fabric
        middle = middle_of(motion[where[0]], round((motion.shape[1] // 2) ** 0.5)).astype(np.float32)
        basis = Basis.of(fields_of(case, layout, times, motion[where]))
        frames = LocalFrames.of(middle, fabric.width, fabric.height, FINE)
        heights = 1e3 * heights_of(basis, frames, fabric, weight_over_stiffness(case))
        pairs = [offsets(frame, cloud, fabric.thickness) for frame, cloud in zip(middle, clouds, strict=True)]
        goal, count = (np.array(x).reshape(len(times), -1) for x in zip(*pairs, strict=True))
        weight = np.minimum(count, _MOST)
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1)
        flat = heights.reshape(*heights.shape[:2], -1)
        goal = np.clip(1e3 * goal, -_FAR, _FAR)
        return Examples(flat.astype(np.float16), goal.astype(np.float32), weight.astype(np.float32))

    def errors(self, coefficients: Floats | None = None) -> NDArray[np.float64]:
        """(T,) mm RMS that is left with these coefficients (K,); by default without any."""
        left = self.goal
        if coefficients is not None:
            left = left - np.einsum("tkn,k->tn", self.heights.astype(np.float32), coefficients.astype(np.float32))
        return np.asarray(np.sqrt((left**2 * self.weight).sum(axis=1)), dtype=np.float64)

    @cached_property
    def equations(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(K, K) and (K,): normal equations of all frames, each by its error before."""
        matrix, right = 0.0, 0.0
        for heights, goal, weight, error in zip(self.heights, self.goal, self.weight, self.errors(), strict=True):
            own = heights.astype(np.float32)
            by = own * weight / max(error, _GOOD) ** 2
            matrix, right = matrix + by @ own.T, right + by @ goal
        return np.asarray(matrix, dtype=np.float64), np.asarray(right, dtype=np.float64)

    def __len__(self) -> int:
        return len(self.goal)

    def save(self, path: Path) -> None:
        with whole_file(path) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **{field.name: getattr(self, field.name) for field in fields(self)})

    @staticmethod
    def load(path: Path) -> "Examples":
        with np.load(path) as arrays:
            return Examples(**{field.name: arrays[field.name] for field in fields(Examples)})
