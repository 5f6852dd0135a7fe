"""How shapes at rest change with parameters: the implicit function theorem, f(x, theta) = 0 (docs/model.md)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.column import Column, move
from fabdesign.nouns.forward import Case
from sim.kernels.fields import LANES, F
from sim.kernels.transfer import put, read
from sim.tangent import fields
from sim.tangent.explicit import Explicit
from sim.tangent.linear import SOLVED
from sim.tangent.shape_kernels import explicit, read_columns, read_found, solve, still, write_columns
from sim.time.batch import Batch

Array = NDArray[np.float64]
ITERATIONS = 100  # at most, of a solve: some 25 are usual
TOLERANCE = 1e-4  # of the preconditioned residual to the solution: soft modes then lack up to 1e-2 of a column
SETTLING = 2  # Newton steps from where a damped motion came to rest
FARTHEST = 1e-3  # m, RMS that they may move it: further lies another shape
STIFFENED = 300.0  # 1/s^2 times the mass that the preconditioner adds, without which it may not be positive definite


@dataclass(frozen=True, eq=False)
class LaneColumns:
    """A case that lies at rest in a lane, and which of the columns are solved there."""

    case: Case
    columns: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Solved:
    """The solution of one lane. settled: whether the forces balance at `middle`, near where the lane came to rest."""

    middle: NDArray[np.float32]  # (n, n, 3) m
    settled: bool
    changes: dict[int, NDArray[np.float32]]  # (n, n, 3) m per unit, by column; those that were not solved are absent


def share_out(cases: Sequence[Case], columns: Sequence[Sequence[int]]) -> list[tuple[int, LaneColumns]]:
    """Return lanes for the cases' `columns`, each with its case's index: where there are spare lanes a case takes
    several, each with some of its columns."""
    copies = max(1, min(LANES // max(len(cases), 1), *map(len, columns)) if columns else 1)
    return [(i, LaneColumns(case, tuple(columns[i][k::copies]))) for i, case in enumerate(cases) for k in range(copies)]


def together(lanes: Sequence[Solved]) -> Solved:
    """Return the solution of one case from all of its lanes, whose shapes are the same to the last bit."""
    changes = {c: change for lane in lanes for c, change in lane.changes.items()}
    return Solved(lanes[0].middle, lanes[0].settled, changes)


def solve_at_rest(
    batch: Batch, lanes: Sequence[LaneColumns], columns: Sequence[Column], pressure: Callable[[Case], Array]
) -> list[Solved]:
    """Return the solutions of the lanes of a batch at rest. pressure(case): (channels,) Pa that act there."""
    fields.allocate()
    still(*batch.grid)
    cases = [lane.case for lane in lanes]
    host = Explicit(cases, batch.nu, pressure)
    before = _positions(batch, F.x0)
    settled = _solve(batch, host, True, SETTLING)[:, -1] == SOLVED
    middle = _positions(batch, F.q)
    moved = np.sqrt(np.square(middle - before).sum(axis=-1).mean(axis=(1, 2)))
    settled &= moved < FARTHEST  # NaN compares false
    changes: list[dict[int, NDArray[np.float32]]] = [{} for _ in lanes]
    for first in range(0, max(len(lane.columns) for lane in lanes), fields.SLOTS):
        wanted = [lane.columns[first : first + fields.SLOTS] for lane in lanes]
        slots = max(map(len, wanted))
        _put_right_sides(batch, cases, [[columns[c] for c in some] for some in wanted], host, middle)
        iterations = _solve(batch, host, False, slots)
        shapes = np.empty((batch.blocks, slots, LANES, batch.nu * batch.nv, 3), np.float32)
        read_columns(*batch.grid, slots, shapes)
        by_lane = shapes.swapaxes(1, 2).reshape(len(lanes), slots, *middle.shape[1:])
        for i, some in enumerate(wanted):
            changes[i] |= {c: by_lane[i, k] for k, c in enumerate(some) if iterations[i, k] == SOLVED}
    return [Solved(middle[i], bool(settled[i]), changes[i]) for i in range(len(lanes))]


def _solve(batch: Batch, host: Explicit, settles: bool, turns: int) -> NDArray[np.int32]:
    """Return (lanes, turns) what came of so many linear solves."""
    solve(
        *batch.grid, batch.points, batch.support, batch.smoothing, int(settles), turns, ITERATIONS, TOLERANCE,
        STIFFENED, host.pressure,
    )  # fmt: skip
    iterations = np.empty((batch.blocks, turns, LANES), np.int32)
    read_found(batch.blocks, turns, iterations)
    return iterations.swapaxes(1, 2).reshape(-1, turns)


def _positions(batch: Batch, plane: int) -> NDArray[np.float32]:
    """Return (lanes, n, n, 3) m in a plane of F.node3."""
    out = np.empty((batch.blocks, LANES, batch.nu * batch.nv, 3), np.float32)
    read(*batch.grid, plane, out)
    return out.reshape(-1, batch.nv, batch.nu, 3)


def _put_right_sides(
    batch: Batch, cases: Sequence[Case], wanted: Sequence[Sequence[Column]], host: Explicit, middle: NDArray[np.float32]
) -> None:
    """Put what each column changes in the forces, at the shape as it is, at the columns' places in the fields."""
    slots = max(map(len, wanted))
    moved = [
        host.moved(
            [
                move(case, columns[slot], columns[slot].step) if slot < len(columns) else None
                for case, columns in zip(cases, wanted, strict=True)
            ]
        )
        for slot in range(slots)
    ]
    forces = host.of_muscles(moved, middle.astype(float).reshape(len(cases), -1, 3))
    write_columns(*batch.grid, slots, forces.reshape(slots, batch.blocks, LANES, -1, 3))
    changes = {slot: change for slot in range(slots) if (change := host.of_cloth(moved[slot])) is not None}
    for slot, change in changes.items():
        for constants, weight in zip(change.sides, (-change.weight, change.weight), strict=True):
            put(batch.blocks, {"lane": constants})
            explicit(*batch.grid, batch.support, slot, weight)
    if changes:
        put(batch.blocks, {"lane": host.constants})
