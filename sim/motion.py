"""A simulated motion: its frames and the faces' points."""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.shape import area_normals
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import SIDE, Case
from sim.grid import Support
from sim.lacing import interpolation_weights


def faces(middle: NDArray[np.float32], thickness: float) -> NDArray[np.float32]:
    """Return (T, 2 * 41 * 41, 3) m from mid-surfaces (T, n, n, 3): half the thickness along the normal, front then
    back.

    Another grid than 41 x 41 is interpolated (cubic, sim.lacing).
    """
    rows = _resample(middle.shape[1]).astype(middle.dtype)
    if middle.shape[1] != SIDE:
        middle = np.einsum("ai,tijc,bj->tabc", rows, middle, rows, optimize=True)
    normal = area_normals(middle)
    normal *= thickness / 2 / np.linalg.norm(normal, axis=-1, keepdims=True)
    sides = [side.reshape(len(middle), SIDE * SIDE, 3) for side in (middle + normal, middle - normal)]
    return np.concatenate(sides, axis=1)


@cache
def _resample(n: int) -> Array:
    """Return (41, n) weights of the output points on a line of n nodes."""
    rows = np.zeros((SIDE, n))
    for k in range(SIDE):
        first, value = interpolation_weights(k * (n - 1) / (SIDE - 1), n)
        rows[k, first : first + 4] = value
    return rows


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

    @cached_property
    def points(self) -> NDArray[np.float32]:
        """Return (T, 3362, 3) m: front face, then back face, 41 x 41 each by rising v, then rising u."""
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
    counts = [len(muscle.fixed_points()) for muscle in case.design.muscles]
    kept = np.setdiff1d(np.arange(sum(counts)), np.cumsum(counts) - 1)  # no interval begins at a muscle's last point
    return SimulatedMotion(time, middle, state[:, kept, 0], state[:, kept, 1], case.design.fabric.thickness, diverged)
