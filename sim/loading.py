"""The contents of the fields for a batch of cases, put there."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.acting import specimen_of
from fabdesign.effects.declaration import Specimen
from fabdesign.errors import InputError
from fabdesign.nouns.forward import Case
from fabdesign.nouns.muscle import BenchTable, MuscleType
from fabdesign.nouns.muscle_law import law_of
from fabdesign.runtime.effort import MEMORY
from sim import state
from sim.grid import Support, masses, node_arrays, node_means
from sim.kernels import fields as f
from sim.kernels.fields import LANES, TABLE, TYPES, F, allocate
from sim.kernels.transfer import fill
from sim.lacing import Lacing, lace, touched
from sim.materials import Lane, lane_constants
from sim.solver.modes import Modes, by_four, modes_across, modes_down, tables
from sim.state import COARSE_DOWN, GREEN, PATCH


@lru_cache(maxsize=64)
def bench_grid(table: BenchTable) -> NDArray[np.float32]:
    """Return (pressures, contractions) N: the muscle law on the kernels' grid."""
    pressure = np.arange(f.TABLE[0])[:, None] * f.PRESSURE_STEP
    contraction = f.FIRST_CONTRACTION + np.arange(f.TABLE[1]) * f.CONTRACTION_STEP
    return law_of(table).tension(pressure, contraction[None]).astype(np.float32)


SIZES = ((43, 96), (43, 256), (83, 96), (163, 96))  # (padded nodes a side, fixed points) that fields are made for


def load(cases: Sequence[Case], n: int, *, support: Support, blocks: int) -> int:
    """Put `cases` into the fields, one a lane, on n x n grids, with the preconditioner's basis: of `blocks` blocks,
    which are made where there are none. Return the most fixed points of any case."""
    points = max(sum(len(m.fixed_points()) for m in case.design.muscles) for case in cases)
    _require_room(points, blocks)
    side, room = next(((a, b) for a, b in SIZES if a >= n + 2 and b >= points), (n + 2, points))
    allocate(side * side, room, side, blocks=blocks)
    across, down = np.max([touched(case.design, n) for case in cases], axis=0).tolist()
    designs = {id(case.design): case.design for case in cases}
    laced = {key: lace(design, n, across, down) for key, design in designs.items()}
    lacings = [laced[id(case.design)] for case in cases]
    specimens = [specimen_of(case) for case in cases]
    types = muscle_table(cases)
    modes, (down_modes, down_eigen) = modes_across(n, support), modes_down(n, support)
    modal = {key: _modal_weights(lacing, modes, points) for key, lacing in laced.items()}
    modal_down = {key: value[1, :, :3, :n] @ down_modes[:, :COARSE_DOWN] for key, value in modal.items()}
    lanes = []
    for case, specimen, lacing in zip(cases, specimens, lacings, strict=True):
        weights = modal[id(case.design)]
        lanes.append(
            node_values(specimen, n)
            | fixed_points(lacing, specimen, types, n)
            | {"across": weights[0], "down": weights[1], "coarse_down": modal_down[id(case.design)]}
        )
    values = {name: side_by_side([lane[name] for lane in lanes]) for name in lanes[0]}
    coarse, place = tables(modes, down_modes, down_eigen)
    fill(
        len(cases) // LANES, values | {"lane": constants_of(specimens, n)},
        across=across, down=down, odd=modes.odd,
        basis=by_four(modes).astype(np.float32),
        eigen=np.stack([modes.stretching, modes.bending, modes.slopes], axis=1).astype(np.float32),
        table=np.array([bench_grid(kind.bench) for _, kind in types], np.float32).reshape(-1, *TABLE),
        coarse=coarse, place=place,
        rows=_rows(lacings, n, len(cases) // LANES, points, down),
    )  # fmt: skip
    return points


def _require_room(points: int, blocks: int) -> None:
    """Raise InputError for too many fixed points: each acts on every other, so memory goes with their number's
    square."""
    pair = blocks * LANES * 4 * (GREEN + 1)
    if points**2 * pair > MEMORY:
        raise InputError(
            f"{points} fixed points in a design; expected at most {int((MEMORY / pair) ** 0.5)}: a wider pitch"
        )


def constants_of(specimens: Sequence[Specimen], n: int) -> NDArray[np.float32]:
    """Return (blocks, constants, LANES): the materials of specimens, one a lane."""
    return side_by_side([lane_constants(Lane(specimen, n)) for specimen in specimens])


def side_by_side(values: Sequence[NDArray]) -> NDArray:
    """Return one array of each lane to (blocks, entries, LANES); of vectors (3, entries) to (blocks, entries, 3,
    LANES)."""
    integers = values[0].dtype.kind == "i"
    vectors = values[0].ndim == 2 and len(values[0]) == 3
    lanes = np.array([value.T if vectors else value.ravel() for value in values], np.int32 if integers else np.float32)
    return by_blocks(lanes)


def by_blocks(lanes: NDArray) -> NDArray:
    """Return (lanes, ...) as the fields have it, (blocks, ..., LANES)."""
    return np.ascontiguousarray(np.moveaxis(lanes.reshape(len(lanes) // LANES, LANES, *lanes.shape[1:]), 1, -1))


def ringed(fields: NDArray) -> NDArray[np.float32]:
    """Return (blocks, nodes, 3, LANES) of vectors (lanes, n, n, 3), with a ring of zeros around each grid."""
    padded = np.pad(fields, ((0, 0), (1, 1), (1, 1), (0, 0))).astype(np.float32)
    return by_blocks(padded.reshape(len(fields), -1, 3))


def node_values(specimen: Specimen, n: int) -> dict[str, NDArray]:
    """Return what a lane has on the padded grid."""
    rest, free = node_arrays(specimen.design.fabric, n)

    def padded(values: NDArray) -> NDArray:
        return np.pad(values.reshape(n, n), 1).ravel()

    positions = np.array([padded(component) for component in rest.T])
    of_places = {name: padded(node_means(specimen, name, n)) for name in state.added("node")}
    return {"x0": positions, "q": positions, "mass": padded(masses(specimen, n)), "free": padded(free)} | of_places


def muscle_table(cases: Sequence[Case]) -> dict[tuple[str, MuscleType], int]:
    types: dict[tuple[str, MuscleType], int] = {}
    for case in cases:
        for named in case.design.muscle_types.items():
            types.setdefault(named, len(types))
    if len(types) > TYPES:
        raise InputError(f"batch: {len(types)} muscle types; expected at most {TYPES}")
    return types


def fixed_points(
    lacing: Lacing, specimen: Specimen, types: dict[tuple[str, MuscleType], int], n: int
) -> dict[str, NDArray]:
    """Return what a lane has at its fixed points; spare ones lie at rest inside the cloth with no interval."""
    damping = specimen.factors.get("damping", 1.0)
    count, room = len(lacing.offset), F.points
    spare, first = np.zeros((4, PATCH)), (n - 1) // 2
    spare[:2, 0], spare[2:4, 0], spare[2:4, 1] = 1, -1, 1  # at a node, tangents to the next
    weights = np.concatenate([lacing.weights[:4], np.repeat(spare[:, None], room - count, axis=1)], axis=1)
    base = np.concatenate([lacing.base, np.full((room - count, 2), first, np.int32)])
    kinds = {name: specimen.design.muscle_types[name] for name in dict.fromkeys(lacing.muscle_type)}
    place = {named[0]: types[named] for named in kinds.items()}  # hashing a bench table takes long

    def filled(values: NDArray, spare: float = 0) -> NDArray:
        return np.pad(values, (0, room - count), constant_values=spare)

    def of_muscles(name: str) -> NDArray:
        values = specimen.muscles.get(name)
        return np.zeros(count) if values is None else values[lacing.muscle]

    return {
        **dict(zip(("wu", "wv", "du", "dv"), weights, strict=True)),
        "offset": filled(of_muscles("lever") * lacing.offset),
        "active": filled(lacing.active),
        "rest": filled(lacing.rest, 1.0),
        "gain": filled(of_muscles("gain")),
        "pressure_share": filled(1 - of_muscles("pressure_loss") * lacing.along),
        "viscosity": filled(damping * np.array([kinds[name].viscosity for name in lacing.muscle_type])),
        "base": (base[:, 0] + 1) * (n + 2) + base[:, 1] + 1,
        "channel": filled(lacing.channel),
        "muscle_type": filled(np.array([place[name] for name in lacing.muscle_type], np.int32)),
        **{name: filled(of_muscles(name)) for name in state.added("interval")},
    }


def _modal_weights(lacing: Lacing, modes: Modes, points: int) -> NDArray[np.float32]:
    """Return (2, points, 4, modes): what F.across and F.down hold of one design: normal means, slopes and moments, and
    across tangential means."""
    n, count = len(modes.normal), len(lacing.offset)
    out = np.zeros((2, points, 4, F.modes), np.float32)
    touched = np.minimum(lacing.base[:, :, None] + np.arange(PATCH), n - 1)  # row, column; weights beyond are zero
    out[0, :count, :3, :n] = np.einsum("fpm,pmk->pfk", lacing.weights[::2], modes.normal[touched[:, 1]])
    out[0, :count, 3, :n] = np.einsum("pm,pmk->pk", lacing.weights[0], modes.tangential[touched[:, 1]])
    point, functional = np.arange(count)[:, None, None], np.arange(3)[None, :, None]
    np.add.at(out[1], (point, functional, touched[:, None, 0]), lacing.weights[1::2].transpose(1, 0, 2))
    return out


def _rows(lacings: Sequence[Lacing], n: int, blocks: int, points: int, down: int) -> NDArray[np.int32]:
    """Return (blocks, points, 2): the first row that a fixed point touches in any lane, and how many times four
    rows."""
    first, last = np.full((blocks, points), n), np.zeros((blocks, points), int)
    for lane, lacing in enumerate(lacings):
        block, row = lane // LANES, lacing.base[:, 0]
        used = slice(len(row))
        first[block, used] = np.minimum(first[block, used], row)
        last[block, used] = np.maximum(last[block, used], np.minimum(row + down, n))
    begin = first // 4  # at multiples of four: sums are the same whatever the other lanes hold
    fours = np.clip(-(-last // 4) - begin, 0, None)
    return np.stack([4 * begin, fours], axis=-1).astype(np.int32)
