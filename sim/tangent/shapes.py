"""How shapes at rest change with parameters: the implicit function theorem, f(x, theta) = 0 (docs/model.md)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.column import Column
from fabdesign.forward import Case
from sim.kernels.fields import LANES
from sim.kernels.transfer import put
from sim.tangent import fields
from sim.tangent.explicit import Explicit, Laid, Move, move
from sim.tangent.linear import SOLVED
from sim.tangent.shape_kernels import explicit_kernel, read_columns, settle_kernel, solve_kernel, still
from sim.time.batch import Batch

Array = NDArray[np.float64]
ITERATIONS = 100  # at most, of a solve: some 25 are usual
TOLERANCE = 1e-4  # of the preconditioned residual to the solution: soft modes then lack up to 1e-2 of a column
SETTLING = 2  # Newton steps from where a damped motion came to rest
STIFFENED = 300.0  # 1/s^2 times the mass that the preconditioner adds, without which it may not be positive definite


@dataclass(frozen=True, eq=False)
class Solved:
    """Columns of one lane."""

    changes: NDArray[np.float32]  # (own columns, n, n, 3) m per unit
    found: NDArray[np.int32]  # (own columns,) SOLVED, UNSOLVED or INDEFINITE

    @property
    def right(self) -> bool:
        return bool((self.found == SOLVED).all())


def changes_at_rest(
    batch: Batch,
    lanes: Sequence[Case],
    own: Sequence[Sequence[Column]],
    pressure: Callable[[Case], Array],
) -> list[Solved]:
    """Of each lane's case, at rest in the fields, its `own` columns."""
    slots = max(map(len, own))
    fields.allocate(slots)
    still(*batch.grid)
    channels = max(1, *(case.program.pressure.shape[1] for case in lanes))
    explicit = Explicit(Laid(lanes, batch.nu, pressure), lanes, channels)
    settle_kernel(batch.added)(
        *batch.grid, batch.points, batch.support, batch.smoothing, SETTLING, ITERATIONS, TOLERANCE, STIFFENED,
        explicit.pressure,
    )  # fmt: skip
    _put_right_sides(batch, lanes, own, explicit)
    solve_kernel(batch.added)(
        *batch.grid, batch.points, batch.support, slots, ITERATIONS, TOLERANCE, explicit.pressure
    )
    out = np.empty((batch.blocks, slots, LANES, batch.nu * batch.nv, 3), np.float32)
    found = np.empty((batch.blocks, slots, LANES), np.int32)
    read_columns(*batch.grid, slots, out, found)
    shapes = out.swapaxes(1, 2).reshape(len(lanes), slots, batch.nv, batch.nu, 3)
    flags = found.swapaxes(1, 2).reshape(len(lanes), slots)
    return [Solved(shape[: len(c)], flag[: len(c)]) for shape, flag, c in zip(shapes, flags, own, strict=True)]


def _put_right_sides(
    batch: Batch, lanes: Sequence[Case], own: Sequence[Sequence[Column]], explicit: Explicit
) -> None:
    """What each column changes in the forces at the shape as it is, to the columns' places in the fields."""
    kernel, changed = explicit_kernel(batch.added), set[str]()
    for slot in range(max(map(len, own))):
        moves: list[Move | None] = [
            move(case, columns[slot], columns[slot].step) if slot < len(columns) else None
            for case, columns in zip(lanes, own, strict=True)
        ]
        for change in explicit.changes(moves):
            values = {**explicit.values(sorted(changed - change.values.keys())), **change.values}
            if values:
                put(batch.blocks, values)
            changed = set(change.values)
            kernel(*batch.grid, batch.points, batch.support, slot, change.pressure, change.weight)
    if changed:
        put(batch.blocks, explicit.values(sorted(changed)))
