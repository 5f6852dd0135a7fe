"""The one forward model: a simulator with all that a model adds, its factors, effects, corrector and sensing."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.acting import is_sensing, observed, seen_at
from fabdesign.geometry.shape import Shape, Sheet, sheets_of
from fabdesign.nouns.array import Array, Floats
from fabdesign.nouns.column import Column, FacesJacobian, Jacobians, move
from fabdesign.nouns.forward import Case, Corrector, ForwardModel, with_history
from fabdesign.nouns.lead import Balancer
from fabdesign.nouns.model import Model
from fabdesign.nouns.pressure import PressureProgram


@dataclass(frozen=True)
class Predictor:
    """A simulator that knows what was fitted. Implements fabdesign.nouns.forward.ForwardModel.

    A case's own factors go before the model's, its own effects act after the model's. sensing: whether what the model
    says of clocks and sensors is in the points, as in `predict`, or not, as in `simulate`.
    """

    simulator: ForwardModel
    model: Model = field(default_factory=Model)
    sensing: bool = False
    corrector: Corrector | None = None  # the model's, loaded

    def motions(self, cases: Sequence[Case], times: Sequence[Array]) -> list[NDArray[np.float32]]:
        """Return (T, 3362, 3) points [m] of each case at its `times` [s after rest, rising]. Raises InputError for an
        unknown effect or a bad value."""
        modelled, shown = self._shown(cases, times)
        if self.corrector is None:
            return self._observed(modelled, self.simulator.motions(modelled, shown))
        wanted = [with_history(t, self.corrector.history())[0] for t in shown]
        corrected = self.corrector.correct(modelled, shown, self.simulator.motions(modelled, wanted))
        return self._observed(modelled, corrected)

    def sheets(self, cases: Sequence[Case], times: Sequence[Array]) -> Sequence[Sheet]:
        """Return the same motions as mid-surfaces on the simulator's own grid (fabdesign.geometry.shape)."""
        if self.corrector is not None:
            return [Shape(points) for points in self.motions(cases, times)]
        modelled, shown = self._shown(cases, times)
        if not self.sensing:
            return sheets_of(self.simulator)(modelled, shown)
        keys = [_key(case, t) for case, t in zip(modelled, shown, strict=True)]
        once: dict[tuple[Any, ...], int] = {}  # cases that differ in what sensors add alone are one motion
        for i, key in enumerate(keys):
            once.setdefault(key, i)
        moved = sheets_of(self.simulator)([modelled[i] for i in once.values()], [shown[i] for i in once.values()])
        by_key = dict(zip(once, moved, strict=True))
        return [_Seen(case, by_key[key]) for case, key in zip(modelled, keys, strict=True)]

    def _shown(self, cases: Sequence[Case], times: Sequence[Array]) -> tuple[list[Case], list[Array]]:
        """Return the cases with what the model adds, and the instants [s] that their frames show."""
        modelled, shown = [self.case(case) for case in cases], [np.asarray(t, dtype=float) for t in times]
        if self.sensing:
            shown = [seen_at(case, t) for case, t in zip(modelled, shown, strict=True)]
        return modelled, shown

    def _observed(self, cases: Sequence[Case], motions: Sequence[Floats]) -> list[NDArray[np.float32]]:
        if not self.sensing:
            return list(motions)
        return [observed(case, points) for case, points in zip(cases, motions, strict=True)]

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        """Return (3362, 3) points [m] of each case at rest, as `motions` gives them."""
        modelled = [self.case(case) for case in cases]
        return self._on_top(modelled, self.simulator.equilibria(modelled))

    @property
    def faces_jacobian(self) -> Jacobians | None:
        """Return shapes at rest, as `equilibria` gives them, and how they change with each column; None where the
        simulator does not offer it."""
        bare: Jacobians | None = getattr(self.simulator, "faces_jacobian", None)
        if bare is None:
            return None

        def jacobians(cases: Sequence[Case], columns: Sequence[Column]) -> list[FacesJacobian]:
            modelled = [self.case(case) for case in cases]
            simulated = bare(modelled, columns)
            if self.corrector is None and not self.sensing:
                return simulated
            return [self._changes(case, columns, one) for case, one in zip(modelled, simulated, strict=True)]

        return jacobians

    def _changes(self, case: Case, columns: Sequence[Column], simulated: FacesJacobian) -> FacesJacobian:
        """Return the Jacobian of what is made on top of a shape, which depends on the case too: central differences of
        it alone, between shapes that move as `simulated` says, as far as a column's `far`."""
        moves = [move(case, column, column.far) for column in columns]
        shifts = np.array([steps.by for steps in moves]).reshape(-1, 2)  # (p, 2) units, down and up
        changes = zip(shifts, simulated.changes, strict=True)
        sides = [simulated.points + by * change for steps, change in changes for by in steps]
        cases = [case, *(side for steps in moves for side in steps.sides)]
        points, *moved = self._on_top(cases, [simulated.points, *sides])
        pairs = np.array(moved, dtype=float).reshape(len(columns), 2, *points.shape)
        with np.errstate(invalid="ignore"):  # of columns that are NaN
            slopes = (pairs[:, 1] - pairs[:, 0]) / np.ptp(shifts, axis=1)[:, None, None]
        return FacesJacobian(points, slopes, simulated.exact)

    @property
    def balancer(self) -> Balancer | None:
        """Return the engine of frames in balance; None where the simulator is none, or a corrector adds what no force
        does."""
        engine = self.simulator
        return engine if self.corrector is None and isinstance(engine, Balancer) else None

    def _on_top(self, cases: Sequence[Case], shapes: Sequence[Floats]) -> list[NDArray[np.float32]]:
        """Return what the corrector and sensing make of shapes at rest; the cases with what the model adds. The
        corrector gets motions that have stood still for as long as it looks back."""
        if self.corrector is not None:
            late = np.array([1.0 + max(self.corrector.history(), default=0.0)])
            instants = len(with_history(late, self.corrector.history())[0])
            programs = [PressureProgram(np.zeros(1), case.program.pressure[-1:], float(late[0])) for case in cases]
            held = [replace(case, program=program) for case, program in zip(cases, programs, strict=True)]
            still = [np.repeat(shape[None], instants, axis=0) for shape in shapes]
            shapes = [points[-1] for points in self.corrector.correct(held, [late] * len(held), still)]
        return self._observed(cases, shapes)

    def case(self, case: Case) -> Case:
        """Return the case with what the model adds."""
        factors = {**self.model.factors, **case.factors}
        return replace(case, factors=factors, effects=(*self.model.terms, *case.effects))


def _key(case: Case, times: Array) -> tuple[Any, ...]:
    terms = tuple((t.name, t.scope, *sorted(t.values.items())) for t in case.effects if not is_sensing(t.name))
    factors = tuple(sorted(case.factors.items()))
    return id(case.design), id(case.program), factors, terms, case.order, times.tobytes()


@dataclass(frozen=True, eq=False)
class _Seen:
    """A sheet as sensors give it; faces only where they are asked for."""

    case: Case
    sheet: Sheet

    @cached_property
    def middle(self) -> Floats:
        return observed(self.case, self.sheet.middle)

    @cached_property
    def points(self) -> Floats:
        return observed(self.case, self.sheet.points)
