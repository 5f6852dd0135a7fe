"""Transfer from the fields to numpy: planes and arrays of a batch, and frames between two steps."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from sim.kernels.fields import LANES, OF_NODES, WIDE, F, X, floats, indices
from sim.kernels.frontend import brief
from sim.kernels.transfer import Values, place_of
from sim.time_steps import H


def take(blocks: int, names: Sequence[str]) -> Values:
    """Return planes and arrays of the batch that lies in the fields, named and shaped as by `fill`."""
    values: dict[str, NDArray] = {}
    for name in names:
        field, first = place_of(name)
        count = getattr(F, field).shape[1] if field == name else F.nodes if field in OF_NODES else F.points
        values[name] = copied(getattr(F, field), blocks, first, count)
    return values


def on_grid(field: Any, grid: tuple[int, int, int], first: int) -> NDArray[np.float32]:
    """Return (lanes, nv, nu, 3) vectors at the nodes of blocks, nu, nv, from the entry `first` of a field on."""
    blocks, nu, nv = grid
    padded = copied(field, blocks, first, (nu + 2) * (nv + 2)).reshape(blocks, nv + 2, nu + 2, 3, LANES)
    return np.moveaxis(padded[:, 1:-1, 1:-1], -1, 1).reshape(-1, nv, nu, 3)


@brief()  # the kernel is compiled for each field
def copied(field: Any, blocks: int, first: int, count: int) -> NDArray[np.float32]:
    """Return `count` entries of a field's blocks, from `first` on: (blocks, count, LANES), of vectors (blocks, count,
    3, LANES)."""
    out = np.empty((blocks, count, field.n), np.float32)
    _copy(field, first, out)
    return out.reshape(blocks, count, 3, LANES) if field.n == WIDE else out


@ti.kernel
def _copy(field: ti.template(), first: ti.i32, out: floats(3)):
    ti.loop_config(serialize=True)
    for b in range(out.shape[0]):
        for k in indices(out.shape[1]):
            for lane in indices(out.shape[2]):
                out[b, k, lane] = field[b, first + k][lane]


@ti.func
def record(b, nu, nv, npt, lane, theta, frame, shapes: ti.template(), states: ti.template()):
    """shapes (frames, nu nv, 3): positions at the fraction theta of the last step, cubic Hermite; states (frames,
    npt, 2): contraction and tension [N] of every interval at its evaluation point."""
    h = F.scheme[b, H][lane]
    b1 = (1 - theta) * (1 - theta) * theta * h
    b2 = theta * theta * (3 - 2 * theta)
    b3 = theta * theta * (theta - 1) * h
    for j in range(nv):
        for i in indices(nu):
            k = (j + 1) * (nu + 2) + i + 1
            for c in range(3):
                e = c * LANES + lane
                old = F.node3[b, F.xp + k][e]
                new = F.node3[b, F.x0 + k][e]
                shapes[frame, j * nu + i, c] = (
                    old + b2 * (new - old) + b1 * F.node3[b, F.vp + k][e] + b3 * F.node3[b, F.v0 + k][e]
                )
    for k in indices(npt):
        states[frame, k, 0] = F.point[b, X.eps + k][lane]
        states[frame, k, 1] = F.point[b, X.tension + k][lane]
