"""Derivatives by central differences of whole shapes and motions: reference, and what the tangent does not cover."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.column import Column, move
from fabdesign.nouns.forward import Case
from fabdesign.nouns.jacobian import FacesJacobian
from sim.motion import faces
from sim.tangent.shapes import Solved

Array = NDArray[np.float64]
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
