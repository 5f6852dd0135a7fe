"""Transfer between numpy and the fields: fill a batch, replace values of it, halt it; its planes, arrays and frames.

A loop that threads share costs 10 ms of every start, so short ones are serial.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from sim import state
from sim.kernels.fields import LANES, OF_NODES, WIDE, C, F, Following, Timed, X, floats, indices, ints
from sim.kernels.frontend import brief
from sim.kernels.vectors import Lanes, Wide
from sim.time_steps import H

Values = Mapping[str, NDArray]  # by the name of a plane or an array, lane beside lane


def fill(blocks: int, values: Values, **shared: Any) -> None:
    """Put a batch into the first blocks, and zero there whatever is not put in and may be read before it is written
    (`life` in sim/state.py).

    values: of every plane and array that is declared as loaded, by name, and of "lane", the constants:
    (blocks, entries, LANES), for vectors (blocks, entries, 3, LANES), from its first entry on. shared: what all lanes
    have in common, by the names of `_fill_shared`.
    """
    if values.keys() != state.loaded() | {"lane"}:
        raise ValueError(f"a batch must load {sorted(state.loaded())} and lane; got {sorted(values)}")
    _fill_shared(blocks, **shared)
    _put(blocks, 1, *_arguments(blocks, values))


def put(blocks: int, values: Values) -> None:
    """Replace some values of the batch that lies in the fields, named and shaped as by `fill`."""
    _put(blocks, 0, *_arguments(blocks, values))


def _arguments(blocks: int, values: Values) -> tuple[NDArray, ...]:
    """Return what the kernel takes: spans, numbers, vectors, whole numbers."""
    spans, parts = [], ([np.zeros((blocks, 1, LANES), np.float32)], [np.zeros((blocks, 1, WIDE), np.float32)],
                        [np.zeros((blocks, 1, LANES), np.int32)])  # fmt: skip
    filled = [1, 1, 1]
    for name, value in values.items():
        field, first = place_of(name)
        sort = 2 if value.dtype.kind == "i" else int(value.ndim == 4)
        part = value.reshape(*value.shape[:2], math.prod(value.shape[2:]))
        spans.append((FIELDS.index(field), first, filled[sort], value.shape[1]))
        parts[sort].append(part)
        filled[sort] += value.shape[1]
    return np.array(spans, np.int32), *(np.concatenate(part, axis=1) for part in parts)


def place_of(name: str) -> tuple[str, int]:
    """Return the field that holds a plane or an array, and its first entry there."""
    for plane in state.PLANES:
        if plane.name == name:
            return plane.field, getattr(F if plane.on in state.BY_NODE else X, name)
    return name, 0


# fields of each lane by name; numbers, vectors and integers that can be put in, and those that a batch zeroes
NUMBERS = (
    "node",
    "point",
    "lane",
    "reduce",
    *(a.name for a in state.ARRAYS if a.life == state.LOADED and not a.integer),
)
VECTORS = ("node3",)
INTEGERS = tuple(a.name for a in state.ARRAYS if a.life == state.LOADED and a.integer)
FIELDS = (*NUMBERS, *VECTORS, *INTEGERS)
OTHERS = tuple(a for a in state.ARRAYS if a.life not in (state.LOADED, state.SCRATCH))
ZEROED = ("node", "point", *(a.name for a in OTHERS if not a.vector))
ZEROED3 = ("node3", "point3", *(a.name for a in OTHERS if a.vector))


@Timed
@ti.kernel
def _put(nb: ti.i32, anew: ti.i32, spans: ints(2), numbers: floats(3), vectors: floats(3), integers: ints(3)):
    """spans (n, 4): field, its first entry, the first entry of the values, how many."""
    ti.loop_config(serialize=True)
    for b in range(nb):
        if anew == 1:
            F.pairs[b] = 0
            for name in ti.static(ZEROED):
                zero(b, ti.static(getattr(F, name)), Lanes(0.0))
            for name in ti.static(ZEROED3):
                zero(b, ti.static(getattr(F, name)), Wide(0.0))
        for s in range(spans.shape[0]):
            for name in ti.static(NUMBERS):
                copy(b, ti.static(FIELDS.index(name)), ti.static(getattr(F, name)), s, spans, numbers, LANES)
            for name in ti.static(VECTORS):
                copy(b, ti.static(FIELDS.index(name)), ti.static(getattr(F, name)), s, spans, vectors, WIDE)
            for name in ti.static(INTEGERS):
                copy(b, ti.static(FIELDS.index(name)), ti.static(getattr(F, name)), s, spans, integers, LANES)


@ti.func
def zero(b, field: ti.template(), nothing):
    for k in indices(field.shape[1]):
        field[b, k] = nothing


@ti.func
def copy(b, index: ti.template(), field: ti.template(), s, spans: ti.template(), values: ti.template(), width):
    if spans[s, 0] == index:
        first = spans[s, 1]
        source = spans[s, 2]
        for lane in indices(width):
            for k in indices(spans[s, 3]):
                field[b, first + k][lane] = values[b, source + k, lane]


@Timed
@ti.kernel
def _fill_shared(
    nb: ti.i32, across: ti.i32, down: ti.i32, odd: ti.i32, basis: floats(2), eigen: floats(2), table: floats(3),
    coarse: floats(1), place: ints(1), rows: ints(3),
):  # fmt: skip
    """across, down: nodes that a fixed point may touch. odd: of the modes across. basis (entries, 8): both bases
    (sim.solver.modes.by_four). eigen (modes, 3). table (types, pressures, contractions) N. coarse (entries,) of
    C.shared, place (entries,) of C.place (sim/solver/modes.py). rows (blocks, points, 2) of F.rows."""
    F.touched[0], F.touched[1], F.odd[None] = across, down, odd
    if ti.static(not isinstance(F.after, Following)):
        k = 0
        while k < F.after.shape[0]:
            F.after[k] = k + 1
            k += 1
    for k in indices(basis.shape[0]):
        for r in ti.static(range(8)):
            F.basis[k][r] = basis[k, r]
    for k in indices(eigen.shape[0]):
        for r in ti.static(range(3)):
            F.eigen[k][r] = eigen[k, r]
    for k in indices(coarse.shape[0]):
        C.shared[k] = coarse[k]
    for k in indices(place.shape[0]):
        C.place[k] = place[k]
    ti.loop_config(serialize=True)
    for t in range(table.shape[0]):
        for p in range(table.shape[1]):
            for k in indices(table.shape[2]):
                F.table[t, p, k] = table[t, p, k]
    ti.loop_config(serialize=True)
    for b in range(nb):
        for k in indices(rows.shape[1]):
            F.rows[b, k][0] = rows[b, k, 0]
            F.rows[b, k][1] = rows[b, k, 1]


@Timed
@ti.kernel
def halt(nb: ti.i32, nu: ti.i32, nv: ti.i32):
    """Zero velocity and acceleration."""
    ti.loop_config(serialize=True)
    for b in range(nb):
        for k in indices((nu + 2) * (nv + 2)):
            F.node3[b, F.v0 + k] = Wide(0.0)
            F.node3[b, F.a0 + k] = Wide(0.0)


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
