"""How far the chosen model is from every trial of a set: a table that fills itself, one trial after another."""

from collections.abc import Callable
from typing import Protocol

from fabdesign.errors import InputError
from fabdesign.metrics import Errors
from fabdesign.model import Model
from fabdesign.trial import Trial
from fabdesign.trial_file import TrialData
from studies.studio.model_choice import ModelChoice
from studies.studio.solver import Answer, Ask

UNKNOWN = (Errors(*[float("nan")] * 5),)


class TrialErrorsView(Protocol):
    def show_trial_errors(self) -> None: ...

    def tell(self, text: str, *, bad: bool = False) -> None: ...


class HasTrials(Protocol):
    """What of a session is asked for."""

    choice: ModelChoice

    @property
    def view(self) -> TrialErrorsView: ...

    @property
    def trials(self) -> list[str]: ...

    def trial(self, label: str) -> Trial: ...


class TrialErrors:
    """by_label: errors of the simulated motion, and of the corrected one where a corrector acts."""

    def __init__(self, session: HasTrials, ask: Callable[[Ask, Callable[[Answer], None]], None]) -> None:
        """ask: has the simulator answer, once it can."""
        self._session, self._ask = session, ask
        self._running = False
        self.by_label: dict[str, tuple[Errors, ...]] = {}

    def begin(self) -> None:
        """A row for every trial, until something is edited or chosen."""
        self._running = True
        self._next()

    def stop(self) -> None:
        self._running = False

    def clear(self) -> None:
        """They were of another model."""
        self.by_label = {}
        self._session.view.show_trial_errors()

    def add(self, label: str, answer: Answer) -> None:
        self.by_label[label] = answer.errors or UNKNOWN
        self._session.view.show_trial_errors()

    def _next(self) -> None:
        session = self._session
        label = next((label for label in session.trials if label not in self.by_label), None)
        if label is None:
            self._running = False
            session.view.tell(f"errors of all {len(self.by_label)} trials")
            return
        try:
            _, _, ask = ask_of_trial(session.trial(label), session.choice.model)
        except InputError as error:
            self._running = False
            session.view.tell(str(error), bad=True)
            return
        choice = session.choice

        def arrived(answer: Answer) -> None:
            if choice is not session.choice:
                return  # of another model than the table is
            self.add(label, answer)
            if self._running:
                self._next()

        self._ask(ask, arrived)


def ask_of_trial(trial: Trial, model: Model) -> tuple[Trial, TrialData, Ask]:
    """The trial with what was measured, and the ask for its motion as sensors see it and its errors. Raises
    InputError."""
    data = trial.load()
    ask = Ask(
        0, "motion", trial.design, trial.program, model, trial.times, trial.order, sensing=True,
        measured=tuple(data.frames),
    )  # fmt: skip
    return trial, data, ask
