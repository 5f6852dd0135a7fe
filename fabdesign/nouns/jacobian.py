"""How the points of a shape at rest change with the columns of a case, and with what a model puts on top of it."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.column import Column, move
from fabdesign.nouns.forward import Case

Floats = NDArray[np.floating[Any]]
OnTop = Callable[[Sequence[Case], Sequence[Floats]], list[NDArray[np.float32]]]  # of cases and their (2 n, 3) m


class FacesJacobian(NamedTuple):
    """The changes of one case at rest. exact: which columns are the tangent's, not differences of shapes."""

    points: Floats  # (2 n, 3) m: front face, then back face
    changes: Floats  # (p, 2 n, 3) m per unit of the column; NaN where a moved case diverged
    exact: NDArray[np.bool_]  # (p,)


Jacobians = Callable[[Sequence[Case], Sequence[Column]], list[FacesJacobian]]


def with_on_top(
    cases: Sequence[Case], columns: Sequence[Column], jacobians: Sequence[FacesJacobian], on_top: OnTop
) -> list[FacesJacobian]:
    """Return the Jacobians of what `on_top` makes of shapes, which depends on the case too: central differences of it
    alone, between shapes that move as `found` says, as far as a column's `far`."""
    results = []
    for case, one in zip(cases, jacobians, strict=True):
        moves = [move(case, column, column.far) for column in columns]
        shifts = np.array([steps.by for steps in moves]).reshape(-1, 2)  # (p, 2) units, down and up
        sides = [one.points + by * change for steps, change in zip(shifts, one.changes, strict=True) for by in steps]
        points, *moved = on_top([case, *(side for steps in moves for side in steps.sides)], [one.points, *sides])
        widths = np.ptp(shifts, axis=1)[:, None, None]
        pairs = np.array(moved, dtype=float).reshape(len(columns), 2, *points.shape)
        with np.errstate(invalid="ignore"):  # of columns that are NaN
            results.append(FacesJacobian(points, (pairs[:, 1] - pairs[:, 0]) / widths, one.exact))
    return results
