"""What is kept of a motion."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.forward import Case
from sim.design.support import Support
from sim.faces import faces

Array = NDArray[np.float64]
FARTHEST = 10.0  # m from the origin, where a hung cloth has diverged


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """One simulated motion. Frames after a divergence are NaN."""

    time: Array  # (T,) s after rest
    middle: NDArray[np.float32]  # (T, n, n, 3) m, mid-surface nodes, rows of rising v
    contraction: NDArray[np.float32]  # (T, intervals), muscle by muscle along its path
    tension: NDArray[np.float32]  # (T, intervals) N
    thickness: float  # m
    diverged: tuple[float, tuple[int, int]] | None  # time [s] of the first lost frame, and its (row, column)

    @property
    def points(self) -> NDArray[np.float32]:
        """(T, 3362, 3) m: front face, then back face, 41 x 41 each by rising v, then rising u."""
        return faces(self.middle, self.thickness)


def motion_of(case: Case, time: Array, middle: NDArray[np.float32], state: NDArray[np.float32]) -> SimulatedMotion:
    fabric = case.design.fabric
    fallen = np.linalg.norm(fabric.gravity) * time**2 / 2 if Support.of(fabric) == Support.NONE else np.zeros(len(time))
    bad = ~(np.abs(middle) < FARTHEST + fallen[:, None, None, None])  # NaN compares false
    diverged = None
    if bad.any():
        first = int(np.argmax(bad.any(axis=(1, 2, 3))))
        row, column = np.argwhere(bad[first].any(axis=-1))[0]
        diverged = (float(time[first]), (int(row), int(column)))
        middle[first:], state[first:] = np.nan, np.nan
    own = [k for m in _spans(case) for k in m]
    return SimulatedMotion(time, middle, state[:, own, 0], state[:, own, 1], case.design.fabric.thickness, diverged)


def _spans(case: Case) -> list[range]:
    """Indices of each muscle's intervals among all fixed points."""
    spans, start = [], 0
    for muscle in case.design.muscles:
        count = len(muscle.fixed_points())
        spans.append(range(start, start + count - 1))
        start += count
    return spans
