"""The shape of the layout that is shown, its distance from the target, and the band of the model's intervals."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from studies.studio.document import Document
from studies.studio.live import Live, LiveShape, Solves
from studies.studio.model_choice import Band
from studies.studio.solver import Answer, Ask
from studies.studio.target import compare


class Shapes:
    """Follows the document. shown: the last shape that came. before: (2 n, 3) m, the one before a jump, until the next
    gesture. band: around `shown`, where it is exact and the model's intervals are known."""

    def __init__(self, document: Document, solver: Solves) -> None:
        self._document = document
        self._live = Live(solver, self._take, lambda reason: document.tell(reason, bad=True))
        self.shown: LiveShape | None = None
        self.before: NDArray[np.float32] | None = None
        self.band: Band | None = None
        self._around: list[NDArray[np.float32]] = []  # shapes of which a band is made
        self._asked = 0  # counts what is asked for bands
        document.listeners.append(self._follow)

    @property
    def waiting(self) -> bool:
        """Return whether the simulator computes, or is to."""
        return not self._live.at_rest

    @property
    def bands(self) -> bool:
        """Return whether the model's intervals make a band around exact shapes at rest."""
        target = self._document.target
        return bool(self._document.choice.around) and (target is None or target.loaded.time is None)

    def turn(self) -> None:
        """Take what has come, and ask what is due."""
        self._live.turn()

    def also(self, ask: Ask, then: Callable[[Answer], None]) -> None:
        """Ask something else of the simulator, once nothing is dragged."""
        self._live.also(ask, then)

    def _follow(self) -> None:
        """Ask for what the document shows now; a shape that is there already is only compared again."""
        document, target = self._document, self._document.target
        self.band = None
        self._asked += 1
        self._live.drop(self._take_nearby)
        time = None if target is None else target.loaded.time
        self._live.want(document.layout, document.choice.model, moving=document.moving, time=time)
        self._live.turn()
        if self.shown is not None and self.shown.layout == document.layout and self._live.at_rest:
            self._use(self.shown)

    def _take(self, shape: LiveShape) -> None:
        self.shown = shape
        if shape.jump is not None or self._document.history.in_gesture:
            self.before = shape.before
        if shape.layout == self._document.layout:
            self._document.seen.forget()
            self._use(shape)
        self._document.show()

    def _use(self, shape: LiveShape) -> None:
        """Compare an exact shape with the target, and ask for the band around it."""
        document, seen = self._document, self._document.seen
        if not shape.exact:
            return
        seen.shape = shape
        if document.target is not None and seen.comparison is None:
            seen.comparison = compare(document.target, shape.points, shape.layout.design)
        self._around = []
        for model in document.choice.around if self.bands else ():
            ask = Ask.at_rest(self._asked, "nearby", shape.layout.design, shape.layout.pressures, model)
            self._live.also(ask, self._take_nearby)

    def _take_nearby(self, answer: Answer) -> None:
        """Take one more of the shapes around the one that is shown; with the last there is a band."""
        if answer.number != self._asked or answer.points is None:
            return
        self._around.append(answer.points)
        if len(self._around) == len(self._document.choice.around):
            self.band = Band.of(self._around)
            self._document.show()
