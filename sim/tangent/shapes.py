"""How shapes at rest change with parameters: the implicit function theorem, f(x, theta) = 0 (docs/model.md); and
central differences of whole shapes: reference, and what the tangent does not cover."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Column, FacesJacobian, move
from fabdesign.nouns.forward import Case
from sim.kernels.fields import LANES, SLOTS, F, T, allocate_tangent
from sim.kernels.transfer import copied, halt, on_grid, put
from sim.loading import ringed
from sim.motion import faces
from sim.schedule import Batch
from sim.tangent.conjugate_gradients import SOLVED
from sim.tangent.explicit import Explicit, LaneColumns, MovedCases
from sim.tangent.shape_kernels import begin, explicit, solve_columns, viscous, write_column

ITERATIONS = 100  # at most, of a solve: some 25 are usual
TOLERANCE = 1e-4  # of the preconditioned residual to the solution: soft modes then lack up to 1e-2 of a column
SETTLING = 2  # Newton steps from where a damped motion came to rest
FARTHEST = 1e-3  # m, RMS that they may move it: further lies another shape
STIFFENED = 300.0  # 1/s^2 times the mass that the preconditioner adds, without which it may not be positive definite


@dataclass(frozen=True, eq=False)
class Solved:
    """The solution of one lane. settled: whether the forces balance at `middle`, near where the lane came to rest."""

    middle: NDArray[np.float32]  # (n, n, 3) m, or responses (k, n, n, 3) m
    settled: bool
    changes: dict[int, NDArray[np.float32]]  # (n, n, 3) m per unit, by column; those that were not solved are absent


Share = tuple[int, tuple[int, ...]]  # a case's number, and those of its columns that a lane solves


def share_out(columns: Sequence[Sequence[int]]) -> list[Share]:
    """Return lanes for the `columns` of each case, each with its case's number: where there are spare lanes a case
    takes several, each with some of its columns."""
    copies = max(1, min(LANES // max(len(columns), 1), *map(len, columns)) if columns else 1)
    return [(i, tuple(some[k::copies])) for i, some in enumerate(columns) for k in range(copies)]


def together(lanes: Sequence[Solved]) -> Solved:
    """Return the solution of one case from all of its lanes, whose shapes are the same to the last bit."""
    changes = {c: change for lane in lanes for c, change in lane.changes.items()}
    return Solved(lanes[0].middle, lanes[0].settled, changes)


def solve_at_rest(batch: Batch, lanes: Sequence[LaneColumns], cases: MovedCases) -> list[Solved]:
    """Return the solutions of the lanes of a batch at rest."""
    halt(*batch.grid)
    balanced = Balanced(batch, lanes, cases, springs=0.0, farthest=FARTHEST)
    changes = balanced.changes()
    return [Solved(balanced.middle[i], bool(balanced.settled[i]), changes[i]) for i in range(len(lanes))]


class Balanced:
    """The lanes of a batch where forces balance with inertia and damping, near x0, at the velocity v0 and the
    acceleration a0 in the fields. springs: 1/s^2 times the mass, that hold the shape. farthest: m, RMS that Newton
    steps may move it; where effects add forces, which are no part of the tangent, it stays at x0 all the same."""

    def __init__(
        self, batch: Batch, lanes: Sequence[LaneColumns], cases: MovedCases, *, springs: float, farthest: float
    ) -> None:
        allocate_tangent()
        begin(*batch.grid, springs)
        self._batch, self._lanes = batch, lanes
        self.host = Explicit(cases, lanes, batch.nu)
        before = batch.positions(F.x0)
        put(batch.blocks, self.host.remembered)
        settled = _solve(batch, self.host, SETTLING, settles=True)[:, -1] == SOLVED
        self.middle = batch.positions(F.q)
        moved = np.sqrt(np.square(self.middle - before).sum(axis=-1).mean(axis=(1, 2)))
        self.settled: NDArray[np.bool_] = settled & (moved < farthest)  # NaN compares false
        if batch.added:
            begin(*batch.grid, springs)
            self.middle = before

    def changes(self) -> list[dict[int, NDArray[np.float32]]]:
        """Return the solutions of each lane's columns, by column."""
        lanes = self._lanes
        changes: list[dict[int, NDArray[np.float32]]] = [{} for _ in lanes]
        for first in range(0, max(len(lane.columns) for lane in lanes), SLOTS):
            wanted = [lane.columns[first : first + SLOTS] for lane in lanes]
            slots = max(map(len, wanted))
            self._put_right_sides(range(first, first + slots))
            shapes, outcomes = self.solved(slots)
            for i, some in enumerate(wanted):
                changes[i] |= {c: shapes[i, k] for k, c in enumerate(some) if outcomes[i, k] == SOLVED}
        return changes

    def _put_right_sides(self, which: range) -> None:
        """Put what the columns in some slots change in the forces, at the shape as it is, at their places in the
        fields."""
        batch, host = self._batch, self.host
        moved = [host.moved(k) for k in which]
        forces = host.of_muscles(moved, self.middle.astype(float).reshape(len(self._lanes), -1, 3))
        for slot, sides in enumerate(moved):
            write_column(slot, self.at_nodes(forces[slot]))
            self.add_viscous(slot, -host.of_damping(sides))
        for slot, sides in enumerate(moved):
            for constants, weight in host.of_cloth(sides):
                put(batch.blocks, {"lane": constants})
                explicit(*batch.grid, batch.support, slot, weight)
        put(batch.blocks, {"lane": host.constants})

    def at_nodes(self, values: Array) -> NDArray[np.float32]:
        """Return (blocks, nodes, 3 LANES) of vectors (lanes, n n, 3), as a column has them."""
        return ringed(values.reshape(self.middle.shape)).reshape(self._batch.blocks, -1, 3 * LANES)

    def add_viscous(self, slot: int, weight: Array) -> None:
        """Add weight (lanes,) times what the velocity vp in the fields, more than is held, changes in the forces."""
        if weight.any():
            batch = self._batch
            by_block = weight.reshape(-1, LANES).astype(np.float32)
            viscous(*batch.grid, batch.points, batch.support, slot, by_block, self.host.pressure)

    def solved(self, slots: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return (lanes, slots, n, n, 3) m, the solutions of right sides in the fields, and what came of them."""
        batch = self._batch
        outcomes = _solve(batch, self.host, slots)
        return np.stack([on_grid(T.columns, batch.grid, slot * F.nodes) for slot in range(slots)], axis=1), outcomes


def _solve(batch: Batch, host: Explicit, turns: int, *, settles: bool = False) -> NDArray[np.float32]:
    """Return (lanes, turns) what came of so many linear solves."""
    solve_columns(
        *batch.grid, batch.points, batch.support, batch.smoothing, int(settles), turns, ITERATIONS, TOLERANCE,
        STIFFENED, host.pressure,
    )  # fmt: skip
    return copied(T.outcome, batch.blocks, 0, turns).swapaxes(1, 2).reshape(-1, turns)


SHIFT = 1e-5  # m that a node is moved at most: normals turn by 1e-3 on grids of 5 mm, and the rest is of second order
Shapes = NDArray[np.floating[Any]]
Outcome = Callable[[Sequence[Case]], list[Shapes]]  # of moved cases


class Jacobian(NamedTuple):
    """The derivatives of one case: mid-surfaces, how they change, and which columns are the tangent's, not
    differences."""

    middle: Shapes  # (n, n, 3) m
    changes: Shapes  # (p, n, n, 3) m per unit of the column; NaN where a moved case diverged
    exact: NDArray[np.bool_]  # (p,)


def differences(
    outcome: Outcome, cases: Sequence[Case], columns: Sequence[Column], pairs: Sequence[tuple[int, int]]
) -> dict[tuple[int, int], Shapes]:
    """Return differences by (case, column) of `pairs`: over as much to both sides as the column's `far` says, in one
    batch."""
    moves = [move(cases[i], columns[c], columns[c].far) for i, c in pairs]
    shapes = outcome([side for both in moves for side in both.sides])
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
    middles = dict(zip(missing, outcome([cases[i] for i in missing]), strict=True)) if missing else {}
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
