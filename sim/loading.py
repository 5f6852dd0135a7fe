"""A batch of cases into the fields."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.forward import Case
from fabdesign.muscle import MuscleType
from sim.fields import LANE_CONSTANTS, LANES, PATCH, TABLE, TYPES, F, X, allocate
from sim.model import Lacing, bench_grid, lace, lane_constants, node_arrays, touched
from sim.transfer import LOADED, load, load_materials

SIZES = ((43, 96), (43, 256), (83, 96), (163, 96))  # (padded nodes a side, fixed points) that fields are made for


def load_batch(cases: Sequence[Case], n: int, *, hung: int, blocks: int) -> int:
    """Put `cases` on n x n grids into the lanes (spare lanes repeat the last one), and the preconditioner's basis.

    Returns the largest number of fixed points of any case.
    """
    points = max(sum(len(m.fixed_points()) for m in case.design.muscles) for case in cases)
    side, room = next(((a, b) for a, b in SIZES if a >= n + 2 and b >= points), (n + 2, points))
    allocate(side * side, room, side, blocks=blocks)
    across, down = np.max([touched(case.design, n) for case in cases], axis=0).tolist()
    designs = {id(case.design): case.design for case in cases}
    laced = {key: lace(design, n, across, down) for key, design in designs.items()}
    lacings = [laced[id(case.design)] for case in cases]
    kinds = _types(cases)
    used = -(-len(cases) // LANES)
    node = np.zeros((used, LOADED, n + 2, n + 2, LANES), np.float32)
    planes = X.gain // F.points + 1  # those before the kernels' own
    point = np.zeros((used, planes, F.points, LANES), np.float32)
    index = np.zeros((used, 3, F.points, LANES), np.int32)
    basis, odd, eigen = _basis(n, hung)
    modal = {key: _modal_weights(lacing, basis, points) for key, lacing in laced.items()}
    weight = np.zeros((used, *next(iter(modal.values())).shape, LANES), np.float32)
    for k in range(used * LANES):
        b, at, i = k // LANES, k % LANES, min(k, len(cases) - 1)
        design, factors = cases[i].design, cases[i].factors
        rest, mass, free = node_arrays(design, factors, n)
        node[b, :3, 1:-1, 1:-1, at] = rest.reshape(n, n, 3).transpose(2, 0, 1)
        node[b, 3, 1:-1, 1:-1, at], node[b, 4, 1:-1, 1:-1, at] = mass.reshape(n, n), free.reshape(n, n)
        weight[b, ..., at] = modal[id(design)]
        if points:
            _put_lacing(point[b, ..., at], index[b, ..., at], lacings[i], cases[i], kinds, n)
    table = np.array([bench_grid(kind.bench) for _, kind in kinds], np.float32).reshape(-1, *TABLE)
    load(
        used, n, n, across, down, odd, _quads(basis, odd), eigen, table, _constants(cases, n),
        node.reshape(used, LOADED, -1, LANES), point.reshape(used, -1, LANES), index,
        weight.reshape(used, 2, -1, LANES), _rows(lacings, n, used, points, down),
    )  # fmt: skip
    return points


def load_constants(cases: Sequence[Case], n: int) -> None:
    """Replace the materials of the batch that lies in the fields by those of `cases`."""
    constants = _constants(cases, n)
    load_materials(len(constants), constants)


def _constants(cases: Sequence[Case], n: int) -> NDArray[np.float32]:
    """(blocks, LANE_CONSTANTS, LANES); spare lanes repeat the last case."""
    blocks = -(-len(cases) // LANES)
    rows = [lane_constants(case.design, case.factors, n) for case in cases]
    rows += [rows[-1]] * (blocks * LANES - len(cases))
    return np.array(rows, np.float32).reshape(blocks, LANES, LANE_CONSTANTS).transpose(0, 2, 1).copy()


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


def _modal_weights(lacing: Lacing, basis: NDArray[np.float64], points: int) -> NDArray[np.float32]:
    """(2, points, 3, modes): what F.across and F.down hold of one design (means, slopes, moments)."""
    n, count = len(basis), len(lacing.offset)
    out = np.zeros((2, points, 3, F.modes), np.float32)
    touched = np.minimum(lacing.base[:, :, None] + np.arange(PATCH), n - 1)  # row, column; weights beyond are zero
    out[0, :count, :, :n] = np.einsum("fpm,pmk->pfk", lacing.weights[::2], basis[touched[:, 1]])
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


def _basis(n: int, hung: int) -> tuple[NDArray[np.float64], int, NDArray[np.float32]]:
    """Eigenvectors across: K phi = lambda W phi of the second difference, free ends, or held at a hung side edge.

    Returns them (n, n), a column each, in the order in which the solve keeps its modes; how many are odd; their lambda.
    """
    stiffness = np.diag(np.r_[1, np.full(n - 2, 2), 1]) - np.diag(np.ones(n - 1), 1) - np.diag(np.ones(n - 1), -1)
    scale = 1 / np.sqrt(np.r_[0.5, np.ones(n - 2), 0.5])  # W^-1/2
    keep = np.arange(n)
    if hung in (2, 3):
        keep = keep[1:] if hung == 2 else keep[:-1]
    values, vectors = np.linalg.eigh((scale[:, None] * stiffness * scale)[np.ix_(keep, keep)], UPLO="U")
    basis, eigen = np.zeros((n, n)), np.full(n, 4.0)
    basis[np.ix_(keep, np.arange(len(keep)))] = scale[keep, None] * vectors
    eigen[: len(keep)] = np.clip(values, 0, None)
    odd, order = 0, np.arange(n)
    if len(keep) == n:  # both side edges alike: vectors are even or odd in turn
        odd, order = n // 2, np.concatenate([np.arange(0, n, 2), np.arange(1, n, 2)])
    return basis[:, order], odd, eigen[order].astype(np.float32)


def _quads(basis: NDArray[np.float64], odd: int) -> NDArray[np.float32]:
    """What F.basis holds: half of the rows of the even vectors, of the odd ones, and the transposes."""
    even = len(basis) - odd
    parts = [basis[:even, :even]]
    if odd:
        parts.append(basis[len(basis) - 1 - np.arange(even, len(basis)), even:])  # their differences lie mirrored
    out = np.zeros((*F.basis.shape, 4), np.float32)
    rows = np.concatenate([_by_four(part) for part in (*parts, *(part.T for part in parts))])
    out[: len(rows)] = rows
    return out


def _by_four(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n/4 rounded up x n, 4): entry [q n + k, r] is row 4 q + r, column k; rows beyond the last are zero."""
    n = len(matrix)
    padded = np.pad(matrix, ((0, -n % 4), (0, 0)))
    return padded.reshape(-1, 4, n).transpose(0, 2, 1).reshape(-1, 4)
