"""Transfer from the fields to numpy: planes and arrays of a batch, its frames, and frames between two steps."""

from collections.abc import Sequence

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from sim.kernels.fields import LANES, WIDE, F, Timed, X, floats, indices
from sim.kernels.transfer import NUMBERS, VECTORS, Values, place_of
from sim.time_steps import H


def take(blocks: int, names: Sequence[str]) -> Values:
    """Return planes and arrays of the batch that lies in the fields, named and shaped as in `Contents`."""
    values: dict[str, NDArray] = {}
    for name in names:
        field, first = place_of(name)
        vector = field in VECTORS
        count = getattr(F, field).shape[1] if field == name else F.nodes if field in ("node", "node3") else F.points
        out = np.empty((blocks, count, WIDE if vector else LANES), np.float32)
        (_take3 if vector else _take)(blocks, NUMBERS.index(field) if not vector else 0, first, out)
        values[name] = out.reshape(blocks, count, 3, LANES) if vector else out
    return values


@Timed
@ti.kernel
def _take(nb: ti.i32, index: ti.i32, first: ti.i32, out: floats(3)):
    ti.loop_config(serialize=True)
    for b in range(nb):
        for name in ti.static(NUMBERS):
            copy_out(b, ti.static(NUMBERS.index(name)), ti.static(getattr(F, name)), index, first, out, LANES)


@Timed
@ti.kernel
def _take3(nb: ti.i32, index: ti.i32, first: ti.i32, out: floats(3)):
    ti.loop_config(serialize=True)
    for b in range(nb):
        copy_out(b, 0, ti.static(F.node3), index, first, out, WIDE)


@ti.func
def copy_out(b, number, field: ti.template(), index, first, out: ti.template(), width):
    if number == index:
        for k in indices(out.shape[1]):
            for lane in indices(width):
                out[b, k, lane] = field[b, first + k][lane]


@Timed
@ti.kernel
def read(nb: ti.i32, nu: ti.i32, nv: ti.i32, plane: ti.i32, out: floats(4)):
    """out (nb, LANES, nu nv, 3): positions in a plane of F.node3."""
    for b in range(nb):
        for lane in range(LANES):
            for j in range(nv):
                for i in indices(nu):
                    for c in range(3):
                        out[b, lane, j * nu + i, c] = F.node3[b, plane + (j + 1) * (nu + 2) + i + 1][c * LANES + lane]


@Timed
@ti.kernel
def read_states(nb: ti.i32, npt: ti.i32, out: floats(4)):
    """out (nb, LANES, npt, 2): contraction and tension [N] of every interval as last evaluated."""
    ti.loop_config(serialize=True)
    for b in range(nb):
        for lane in range(LANES):
            for k in indices(npt):
                out[b, lane, k, 0] = F.point[b, X.eps + k][lane]
                out[b, lane, k, 1] = F.point[b, X.tension + k][lane]


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
