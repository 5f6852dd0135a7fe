"""A column of a Jacobian: a direction in the parameters of a case, as the case moved along it; and how the points of a
shape at rest, and frames of a motion, change with columns."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array, Floats
from fabdesign.nouns.forward import Case, Instant
from fabdesign.nouns.muscle import Muscle
from fabdesign.nouns.pressure import PressureProgram


def _everywhere(_: Case) -> tuple[float, float]:
    return -np.inf, np.inf


@dataclass(frozen=True)
class Column:
    """A direction: `moved(case, by)` is the case with its parameter moved by so many units.

    step: units by which the parameter is moved to see what forces change, small against what the model bends over;
    far: units for differences of whole shapes and motions, large against what a solver leaves. room: how far a case's
    parameter may be moved down and up. differences: whether those stand in for a tangent that is not there, else NaN.
    """

    name: str
    unit: str
    step: float
    far: float
    moved: Callable[[Case, float], Case]
    room: Callable[[Case], tuple[float, float]] = _everywhere
    differences: bool = True


@dataclass(frozen=True, eq=False)
class Move:
    """One case moved to both sides along one column."""

    sides: tuple[Case, Case]
    by: tuple[float, float]  # down and up, in the column's unit

    @property
    def width(self) -> float:
        """Return the width between both sides, in the column's unit."""
        return self.by[1] - self.by[0]


def move(case: Case, column: Column, step: float) -> Move:
    """Return the case moved to both sides by `step`, or as far as the column goes."""
    least, most = column.room(case)
    low, high = max(-step, least), min(step, most)
    return Move((column.moved(case, low), column.moved(case, high)), (low, high))


def pressure(channel: int, *, far: float = 2e3) -> Column:
    """Return the column [Pa] of all set points of a channel together. A case without that channel stays."""

    def moved(case: Case, by: float) -> Case:
        program = case.program
        if channel >= program.pressure.shape[1]:
            return case
        rows = program.pressure.copy()
        rows[:, channel] += by
        return replace(case, program=PressureProgram(program.time, rows, program.duration))

    def room(case: Case) -> tuple[float, float]:
        rows = case.program.pressure
        return (-float(rows[:, channel].min()) if channel < rows.shape[1] else -np.inf), np.inf

    return Column(f"pressure {channel}", "Pa", 100.0, far, moved, room)


def factor(name: str) -> Column:
    """Return the column of a factor on a declared value, by its name in Case.factors."""

    def moved(case: Case, by: float) -> Case:
        factors: Mapping[str, float] = case.factors
        return replace(case, factors={**factors, name: factors.get(name, 1.0) + by})

    return Column(name, "1", 1e-3, 0.02, moved)


def corner(muscle: int, index: int, along: tuple[float, float]) -> Column:
    """Return the column [m] of a corner (or an end) of a muscle's path along a direction (u, v); the intervals stay as
    many as they are. A case without that corner, and a path that no pitch leaves its intervals, stay: the derivative is
    zero."""

    def moved(case: Case, by: float) -> Case:
        muscles = list(case.design.muscles)
        if muscle >= len(muscles) or index >= len(muscles[muscle].path):
            return case
        path = list(muscles[muscle].path)
        u, v = path[index]
        path[index] = u + by * along[0], v + by * along[1]
        muscles[muscle] = _with_path(muscles[muscle], tuple(path))
        return replace(case, design=replace(case.design, muscles=tuple(muscles)))

    return Column(f"muscle {muscle} corner {index}", "m", 1e-5, 1e-3, moved)


def _with_path(muscle: Muscle, path: tuple[tuple[float, float], ...]) -> Muscle:
    """Return the muscle along another path, with as many intervals; as it is where no pitch leaves them so."""
    before, after = (np.hypot(*np.diff(corners, axis=0).T) for corners in (muscle.path, path))
    counts = np.maximum(1, np.round(before / muscle.fixed_point_pitch))
    least = float((after / (counts + 0.5)).max() * (1 + 1e-9))
    most = float(np.min(np.where(counts > 1, after / (counts - 0.5), np.inf)) * (1 - 1e-9))
    if least > most:
        return muscle
    return replace(muscle, path=path, fixed_point_pitch=float(np.clip(muscle.fixed_point_pitch, least, most)))


class FacesJacobian(NamedTuple):
    """The changes of one case at rest. exact: which columns are the tangent's, not differences of shapes."""

    points: Floats  # (2 n, 3) m: front face, then back face
    changes: Floats  # (p, 2 n, 3) m per unit of the column; NaN where a moved case diverged
    exact: NDArray[np.bool_]  # (p,)


Jacobians = Callable[[Sequence[Case], Sequence[Column]], list[FacesJacobian]]


SPRINGS = 400.0  # 1/s^2, that hold a frame in balance: an error of its acceleration over them is a displacement, and
# the square of a swing's 8 rad/s counts for little beside them


class Balance(NamedTuple):
    """How the mid-surface of a frame of a motion moves where its forces balance with inertia and damping."""

    responses: Floats  # (k, n, n, 3) m, to the inertia and damping of an instant's displacements
    changes: Floats  # (p, n, n, 3) m per unit of the column; NaN, as `responses`, where there is no tangent


class Course(NamedTuple):
    """A motion of a case from rest on, and frames of it. time: (T,) s, rising; middle: (T, n, n, 3) m."""

    time: Array
    middle: Floats
    instants: Sequence[Instant]
