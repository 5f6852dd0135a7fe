"""The two faces of a mid-surface: what a depth camera would see."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.forward import SIDE
from sim.design.loops import interpolation_weights


def faces(middle: NDArray[np.float32], thickness: float) -> NDArray[np.float32]:
    """(T, 2 * 41 * 41, 3) m from mid-surfaces (T, n, n, 3): half the thickness along the normal, front then back.

    Another grid than 41 x 41 is interpolated (cubic, sim.design.loops).
    """
    rows = _resample(middle.shape[1]).astype(middle.dtype)
    if middle.shape[1] != SIDE:
        middle = np.einsum("ai,tijc,bj->tabc", rows, middle, rows, optimize=True)
    down, across = np.empty_like(middle), np.empty_like(middle)
    down[:, 1:-1], down[:, 0], down[:, -1] = (
        middle[:, 2:] - middle[:, :-2],
        middle[:, 1] - middle[:, 0],
        middle[:, -1] - middle[:, -2],
    )
    across[:, :, 1:-1], across[:, :, 0], across[:, :, -1] = (
        middle[:, :, 2:] - middle[:, :, :-2],
        middle[:, :, 1] - middle[:, :, 0],
        middle[:, :, -1] - middle[:, :, -2],
    )
    normal = np.cross(down, across)
    normal *= thickness / 2 / np.linalg.norm(normal, axis=-1, keepdims=True)
    frames = len(middle)
    return np.concatenate([(middle + normal).reshape(frames, -1, 3), (middle - normal).reshape(frames, -1, 3)], axis=1)


def _resample(n: int) -> NDArray[np.float64]:
    """(41, n) weights of the output points on a line of n nodes."""
    rows = np.zeros((SIDE, n))
    for k in range(SIDE):
        first, value = interpolation_weights(k * (n - 1) / (SIDE - 1), n)
        rows[k, first : first + 4] = value
    return rows
