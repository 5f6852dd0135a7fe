"""How shapes at rest change with parameters: the implicit function theorem, f(x, theta) = 0 (docs/model.md); and
central differences of whole shapes and motions: reference, and what the tangent does not cover."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Column, FacesJacobian, move
from fabdesign.nouns.forward import Case
from sim.kernels.fields import LANES, SLOTS, F, allocate_tangent
from sim.kernels.transfer import put
from sim.motion import faces
from sim.schedule import Batch
from sim.tangent.explicit import Explicit
from sim.tangent.shape_kernels import SOLVED, explicit, read_columns, read_outcomes, solve_columns, still, write_columns

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
    allocate_tangent()
    still(*batch.grid)
    cases = [lane.case for lane in lanes]
    host = Explicit(cases, batch.nu, pressure)
    before = batch.positions(F.x0)
    settled = _solve(batch, host, True, SETTLING)[:, -1] == SOLVED
    middle = batch.positions(F.q)
    moved = np.sqrt(np.square(middle - before).sum(axis=-1).mean(axis=(1, 2)))
    settled &= moved < FARTHEST  # NaN compares false
    changes: list[dict[int, NDArray[np.float32]]] = [{} for _ in lanes]
    for first in range(0, max(len(lane.columns) for lane in lanes), SLOTS):
        wanted = [lane.columns[first : first + SLOTS] for lane in lanes]
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
    solve_columns(
        *batch.grid, batch.points, batch.support, batch.smoothing, int(settles), turns, ITERATIONS, TOLERANCE,
        STIFFENED, host.pressure,
    )  # fmt: skip
    iterations = np.empty((batch.blocks, turns, LANES), np.int32)
    read_outcomes(batch.blocks, turns, iterations)
    return iterations.swapaxes(1, 2).reshape(-1, turns)


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


SHIFT = 1e-5  # m that a node is moved at most: normals turn by 1e-3 on grids of 5 mm, and the rest is of second order
Shapes = NDArray[np.floating[Any]]
Outcome = Callable[[Sequence[int], Sequence[Case]], list[Shapes]]  # of moved cases, and of which case each is one


class Jacobian(NamedTuple):
    """The derivatives of one case: mid-surfaces, how they change, and which columns are the tangent's, not
    differences."""

    middle: Shapes  # ([T,] n, n, 3) m
    changes: Shapes  # (p, [T,] n, n, 3) m per unit of the column; NaN where a moved case diverged
    exact: NDArray[np.bool_]  # (p,)


def differences(
    outcome: Outcome, cases: Sequence[Case], columns: Sequence[Column], pairs: Sequence[tuple[int, int]]
) -> dict[tuple[int, int], Shapes]:
    """Return differences by (case, column) of `pairs`: over as much to both sides as the column's `far` says, in one
    batch."""
    moves = [move(cases[i], columns[c], columns[c].far) for i, c in pairs]
    shapes = outcome([i for i, _ in pairs for _ in range(2)], [side for both in moves for side in both.sides])
    return {
        pair: (shapes[2 * k + 1].astype(float) - shapes[2 * k]) / both.width
        for k, (pair, both) in enumerate(zip(pairs, moves, strict=True))
    }


def completed(
    outcome: Outcome, cases: Sequence[Case], columns: Sequence[Column], solved: Mapping[int, Solved]
) -> list[Jacobian]:
    """Return Jacobians of all cases: what the tangent `solved`, by case, and differences of the outcome for the rest,
    but for columns without."""
    known = {i: solution for i, solution in solved.items() if solution.settled}
    missing = [i for i in range(len(cases)) if i not in known]
    middles = dict(zip(missing, outcome(missing, [cases[i] for i in missing]), strict=True)) if missing else {}
    middles |= {i: solution.middle for i, solution in known.items()}
    pairs = [
        (i, c) for i in range(len(cases)) for c in range(len(columns)) if i not in known or c not in known[i].changes
    ]
    made = [(i, c) for i, c in pairs if columns[c].differences]
    changes = differences(outcome, cases, columns, made) if made else {}
    changes |= {(i, c): np.full_like(middles[i], np.nan) for i, c in pairs if not columns[c].differences}
    return [
        Jacobian(
            middles[i],
            np.array([changes[i, c] if (i, c) in changes else known[i].changes[c] for c in range(len(columns))])
            .reshape(len(columns), *middles[i].shape),
            np.array([(i, c) not in changes for c in range(len(columns))], dtype=bool),
        )
        for i in range(len(cases))
    ]  # fmt: skip


def faces_changes(jacobian: Jacobian, thickness: float) -> FacesJacobian:
    """Return a shape's faces, and their changes by central differences in float64, of its mid-surface (n, n, 3) m."""
    middle, changes = jacobian.middle.astype(float), jacobian.changes.astype(float)
    [points] = faces(middle[None], thickness)
    largest = np.abs(changes).max(axis=(1, 2, 3), initial=0.0)
    by = SHIFT / np.where(largest > 0, largest, 1.0)[:, None, None, None]
    ahead, behind = (faces(middle + sign * by * changes, thickness) for sign in (1, -1))
    return FacesJacobian(points, (ahead - behind) / (2 * by[:, 0]), jacobian.exact)
