"""The own drawing and the results of searches: which of them is shown, and what stands beside it."""

from typing import TYPE_CHECKING

from studies.studio.layout import Layout
from studies.studio.results import Result, Row, Seen
from studies.studio.target import Comparison

if TYPE_CHECKING:
    from studies.studio.session import Session


class Drawings:
    """shown: a result; None: the own drawing. beside: whether another drawing is shown beside."""

    def __init__(self, session: "Session") -> None:
        self._session = session
        self.own = Seen()
        self.results: list[Result] = []
        self.shown: Result | None = None
        self.beside = True

    @property
    def seen(self) -> Seen:
        """Of the drawing that is shown."""
        return self.own if self.shown is None else self.shown

    @property
    def comparison(self) -> Comparison | None:
        return self.seen.comparison

    def forget(self) -> None:
        """What was seen was under another model, or beside another target."""
        for seen in (self.own, *self.results):
            seen.forget()

    def add(self, result: Result) -> None:
        self.results.append(result)
        self.show(result)

    def show(self, result: Result | None) -> None:
        """In place of what is shown; None: the own drawing."""
        self._session.document.end()
        self.shown = result if result in self.results else None
        self._session.changed()
        self._session.view.show_results()

    def changed(self, result: Result) -> None:
        """A better one was found."""
        if self.shown is result:
            self._session.changed()
        self._session.view.show_results()

    def take(self) -> None:
        """The result that is shown becomes the own drawing, as a step that can be undone; an edit does so too."""
        if self.shown is None:
            return
        result, self.shown = self.shown, None
        self._session.document.take(f"take {result.name}", result.layouts)
        self.own.shape, self.own.comparison = result.shape, result.comparison
        self._session.changed()
        self._session.view.show_results()

    def other(self) -> tuple[Layout, Seen] | None:
        """The drawing that is shown beside: the own one beside a result, the last result beside the own one."""
        if not self.beside:
            return None
        if self.shown is not None:
            return self._session.document.layout, self.own
        if not self.results:
            return None
        return self.results[-1].layout(self._session.targets.pose), self.results[-1]

    def set_beside(self, on: bool) -> None:
        self.beside = on
        self._session.view.show_layout()
        self._session.view.show_comparison()

    def rows(self) -> list[Row]:
        """Of the table that compares the own drawing with the results."""
        pose, alone = self._session.targets.pose, len(self._session.targets.all) == 1
        own = Row.of("own drawing", self._session.document.layout, self.own, shown=self.shown is None)
        return [own] + [
            # over several poses a search's objective is a mean
            Row.of(r.name, r.layout(pose), r, shown=self.shown is r, objective=r.objective if alone else None)
            for r in self.results
        ]
