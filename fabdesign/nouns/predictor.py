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
from fabdesign.nouns.column import Balances, Column, FacesJacobian, Jacobians, with_on_top
from fabdesign.nouns.corrector import Corrector, with_history
from fabdesign.nouns.forward import Case, ForwardModel
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
        modelled = [self.case(case) for case in cases]
        shown = [np.asarray(t, dtype=float) for t in times]
        if self.sensing:
            shown = [seen_at(case, t) for case, t in zip(modelled, shown, strict=True)]
        motions = self._corrected(modelled, shown)
        if not self.sensing:
            return motions
        return [observed(case, points) for case, points in zip(modelled, motions, strict=True)]

    def sheets(self, cases: Sequence[Case], times: Sequence[Array]) -> Sequence[Sheet]:
        """Return the same motions as mid-surfaces on the simulator's own grid (fabdesign.geometry.shape)."""
        if self.corrector is not None:
            return [Shape(points) for points in self.motions(cases, times)]
        modelled = [self.case(case) for case in cases]
        shown = [np.asarray(t, dtype=float) for t in times]
        if not self.sensing:
            return sheets_of(self.simulator)(modelled, shown)
        shown = [seen_at(case, t) for case, t in zip(modelled, shown, strict=True)]
        once: dict[tuple[Any, ...], int] = {}  # cases that differ in what sensors add alone are one motion
        for i, (case, t) in enumerate(zip(modelled, shown, strict=True)):
            once.setdefault(_key(case, t), i)
        moved = sheets_of(self.simulator)([modelled[i] for i in once.values()], [shown[i] for i in once.values()])
        by_key = dict(zip(once, moved, strict=True))
        return [_Seen(case, by_key[_key(case, t)]) for case, t in zip(modelled, shown, strict=True)]

    def _corrected(self, cases: Sequence[Case], times: Sequence[Array]) -> list[NDArray[np.float32]]:
        if self.corrector is None:
            return self.simulator.motions(cases, times)
        wanted = [with_history(t, self.corrector.history())[0] for t in times]
        return self.corrector.correct(cases, times, self.simulator.motions(cases, wanted))

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
            return with_on_top(modelled, columns, simulated, self._on_top)

        return jacobians

    @property
    def balances(self) -> Balances | None:
        """Return how frames of motions change where forces balance; None where the simulator does not offer it, or a
        corrector adds what no force does."""
        bare: Balances | None = getattr(self.simulator, "balances", None)
        return None if self.corrector is not None else bare

    def _on_top(self, cases: Sequence[Case], shapes: Sequence[Floats]) -> list[NDArray[np.float32]]:
        """Return what the corrector and sensing make of shapes at rest; the cases with what the model adds."""
        if self.corrector is not None:
            shapes = self._corrected_at_rest(self.corrector, cases, shapes)
        if not self.sensing:
            return list(shapes)
        return [observed(case, points) for case, points in zip(cases, shapes, strict=True)]

    @staticmethod
    def _corrected_at_rest(
        corrector: Corrector, cases: Sequence[Case], shapes: Sequence[Floats]
    ) -> list[NDArray[np.float32]]:
        """Return the corrected last shapes of motions that have stood still for as long as the corrector looks back."""
        late = np.array([1.0 + max(corrector.history(), default=0.0)])
        instants = len(with_history(late, corrector.history())[0])
        programs = [PressureProgram(np.zeros(1), case.program.pressure[-1:], float(late[0])) for case in cases]
        held = [replace(case, program=program) for case, program in zip(cases, programs, strict=True)]
        still = [np.repeat(shape[None], instants, axis=0) for shape in shapes]
        return [points[-1] for points in corrector.correct(held, [late] * len(held), still)]

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
