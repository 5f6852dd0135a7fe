"""A batch of cases into the fields."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fabdesign.effort import MEMORY
from fabdesign.errors import InputError
from fabdesign.forward import Case
from fabdesign.muscle import MuscleType
from sim.design.lacing import Lacing, lace, touched
from sim.design.muscle_law import bench_grid
from sim.design.nodes import node_arrays
from sim.kernels.fields import COARSE_DOWN, GREEN, LANE_CONSTANTS, LANES, PATCH, TABLE, TYPES, F, X, allocate
from sim.kernels.transfer import LOADED, load, load_materials
from sim.materials import lane_constants
from sim.solver.coarse_tables import tables
from sim.solver.modes import Modes, by_four, modes_across, modes_down

SIZES = ((43, 96), (43, 256), (83, 96), (163, 96))  # (padded nodes a side, fixed points) that fields are made for


def load_batch(cases: Sequence[Case], n: int, *, hung: int, blocks: int) -> int:
    """Put `cases`, one a lane, on n x n grids into the fields, and the preconditioner's basis.

    Returns the largest number of fixed points of any case.
    """
    points = max(sum(len(m.fixed_points()) for m in case.design.muscles) for case in cases)
    _require_room(points, blocks)
    side, room = next(((a, b) for a, b in SIZES if a >= n + 2 and b >= points), (n + 2, points))
    allocate(side * side, room, side, blocks=blocks)
    across, down = np.max([touched(case.design, n) for case in cases], axis=0).tolist()
    designs = {id(case.design): case.design for case in cases}
    laced = {key: lace(design, n, across, down) for key, design in designs.items()}
    lacings = [laced[id(case.design)] for case in cases]
    kinds = _types(cases)
    used = len(cases) // LANES
    node = np.zeros((used, LOADED, n + 2, n + 2, LANES), np.float32)
    planes = X.gain // F.points + 1  # those before the kernels' own
    point = np.zeros((used, planes, F.points, LANES), np.float32)
    index = np.zeros((used, 3, F.points, LANES), np.int32)
    modes, (down_modes, down_eigen) = modes_across(n, hung), modes_down(n, hung)
    basis, eigen = np.zeros((*F.basis.shape, 8), np.float32), np.zeros((*F.eigen.shape, 3), np.float32)
    quads = by_four(modes)
    basis[: len(quads)] = quads
    eigen[:n] = np.stack([modes.stretching, modes.bending, modes.slopes], axis=1)
    shared, place = tables(modes, down_modes, down_eigen)
    modal = {key: _modal_weights(lacing, modes, points) for key, lacing in laced.items()}
    weight = np.zeros((used, *next(iter(modal.values())).shape, LANES), np.float32)
    coarse = np.zeros((used, points, 3, COARSE_DOWN, LANES), np.float32)
    modal_down = {key: value[1, :, :3, :n] @ down_modes[:, :COARSE_DOWN] for key, value in modal.items()}
    for k in range(used * LANES):
        b, at = k // LANES, k % LANES
        design, factors = cases[k].design, cases[k].factors
        rest, mass, free = node_arrays(design, factors, n)
        node[b, :3, 1:-1, 1:-1, at] = rest.reshape(n, n, 3).transpose(2, 0, 1)
        node[b, 3, 1:-1, 1:-1, at], node[b, 4, 1:-1, 1:-1, at] = mass.reshape(n, n), free.reshape(n, n)
        weight[b, ..., at] = modal[id(design)]
        coarse[b, ..., at] = modal_down[id(design)]
        if points:
            _put_lacing(point[b, ..., at], index[b, ..., at], lacings[k], cases[k], kinds, n)
    table = np.array([bench_grid(kind.bench) for _, kind in kinds], np.float32).reshape(-1, *TABLE)
    load(
        used, n, n, across, down, modes.odd, basis, eigen, table, _constants(cases, n),
        node.reshape(used, LOADED, -1, LANES), point.reshape(used, -1, LANES), index,
        weight.reshape(used, 2, -1, LANES), _rows(lacings, n, used, points, down),
        shared, place, coarse.reshape(used, -1, LANES),
    )  # fmt: skip
    return points


def _require_room(points: int, blocks: int) -> None:
    """Every fixed point acts on every other: memory goes with the square of their number."""
    pair = blocks * LANES * 4 * (GREEN + 1)
    if points**2 * pair > MEMORY:
        raise InputError(
            f"{points} fixed points in a design; expected at most {int((MEMORY / pair) ** 0.5)}: a wider pitch"
        )


def load_constants(cases: Sequence[Case], n: int) -> None:
    """Replace the materials of the batch that lies in the fields by those of `cases`."""
    constants = _constants(cases, n)
    load_materials(len(constants), constants)


def _constants(cases: Sequence[Case], n: int) -> NDArray[np.float32]:
    """(blocks, LANE_CONSTANTS, LANES)"""
    rows = [lane_constants(case.design, case.factors, n) for case in cases]
    return np.array(rows, np.float32).reshape(-1, LANES, LANE_CONSTANTS).transpose(0, 2, 1).copy()


def _types(cases: Sequence[Case]) -> dict[tuple[str, MuscleType], int]:
    kinds: dict[tuple[str, MuscleType], int] = {}
    for case in cases:
        for name, kind in case.design.muscle_types.items():
            kinds.setdefault((name, kind), len(kinds))
    if len(kinds) > TYPES:
        raise InputError(f"batch: {len(kinds)} muscle types; expected at most {TYPES}")
    return kinds


def _put_lacing(
    point: NDArray[np.float32],
    index: NDArray[np.int32],
    lacing: Lacing,
    case: Case,
    kinds: dict[tuple[str, MuscleType], int],
    n: int,
) -> None:
    """point (planes, p), index (3, p) of one lane; spare points lie at rest inside the cloth with no interval."""
    gain, lever = case.factors.get("muscle_gain", 1.0), case.factors.get("axis_offset", 1.0)
    damping = case.factors.get("damping", 1.0)
    count, room = len(lacing.offset), point.shape[1]
    spare, first = np.zeros((4, PATCH)), (n - 1) // 2
    spare[:2, 0], spare[2:4, 0], spare[2:4, 1] = 1, -1, 1  # at a node, tangents to the next
    weights = np.concatenate([lacing.weights[:4], np.repeat(spare[:, None], room - count, axis=1)], axis=1)
    base = np.concatenate([lacing.base, np.full((room - count, 2), first, np.int32)])
    for name, group in zip(("wu", "wv", "du", "dv"), weights, strict=True):
        start = getattr(X, name) // F.points  # a group of planes holds the weights point by point
        point[start : start + PATCH] = group.reshape(PATCH, room)
    kind = [case.design.muscle_types[name] for name in lacing.kind]
    rows = {
        "offset": lever * lacing.offset,
        "active": lacing.active,
        "gain": np.full(count, gain),
        "viscosity": damping * np.array([k.viscosity for k in kind]),
    }
    for name, values in rows.items():
        point[getattr(X, name) // F.points, :count] = values
    point[X.rest // F.points] = 1.0
    point[X.rest // F.points, :count] = lacing.rest
    index[0] = (base[:, 0] + 1) * (n + 2) + base[:, 1] + 1
    index[1, :count] = lacing.channel
    index[2, :count] = [kinds[(name, k)] for name, k in zip(lacing.kind, kind, strict=True)]


def _modal_weights(lacing: Lacing, modes: Modes, points: int) -> NDArray[np.float32]:
    """(2, points, 4, modes): what F.across and F.down hold of one design: normal means, slopes and moments, and across
    tangential means."""
    n, count = len(modes.normal), len(lacing.offset)
    out = np.zeros((2, points, 4, F.modes), np.float32)
    touched = np.minimum(lacing.base[:, :, None] + np.arange(PATCH), n - 1)  # row, column; weights beyond are zero
    out[0, :count, :3, :n] = np.einsum("fpm,pmk->pfk", lacing.weights[::2], modes.normal[touched[:, 1]])
    out[0, :count, 3, :n] = np.einsum("pm,pmk->pk", lacing.weights[0], modes.tangential[touched[:, 1]])
    point, kind = np.arange(count)[:, None, None], np.arange(3)[None, :, None]
    np.add.at(out[1], (point, kind, touched[:, None, 0]), lacing.weights[1::2].transpose(1, 0, 2))
    return out


def _rows(lacings: Sequence[Lacing], n: int, blocks: int, points: int, down: int) -> NDArray[np.int32]:
    """(blocks, points, 2): the first row that a fixed point touches in any lane, and how many times four rows."""
    first, last = np.full((blocks, points), n), np.zeros((blocks, points), int)
    for lane, lacing in enumerate(lacings):
        block, row = lane // LANES, lacing.base[:, 0]
        own = slice(len(row))
        first[block, own] = np.minimum(first[block, own], row)
        last[block, own] = np.maximum(last[block, own], np.minimum(row + down, n))
    begin = first // 4  # at multiples of four: sums are the same whatever the other lanes hold
    fours = np.clip(-(-last // 4) - begin, 0, None)
    return np.stack([4 * begin, fours], axis=-1).astype(np.int32)
