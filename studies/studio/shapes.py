"""The shape of the layout that is shown, its distance from the target, and the band of the model's intervals."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from studies.studio.band import Band
from studies.studio.live import Live, LiveShape, Solves
from studies.studio.solver import Answer, Ask
from studies.studio.target import compare

if TYPE_CHECKING:
    from studies.studio.session import Session


class Shapes:
    """shown: the last shape that came. band: around it, where it is exact and the model's intervals are known."""

    def __init__(self, session: "Session", solver: Solves) -> None:
        self._session = session
        self._live = Live(solver, self._came, lambda reason: session.view.tell(reason, bad=True))
        self.shown: LiveShape | None = None
        self.band: Band | None = None
        self._around: list[NDArray[np.float32]] = []  # shapes of which a band is made
        self._asked = 0  # counts what is asked for bands

    @property
    def waiting(self) -> bool:
        """Whether the simulator computes, or is to."""
        return not self._live.at_rest

    def turn(self) -> None:
        """Take what has come, and ask what is due."""
        self._live.turn()

    def also(self, ask: Ask, then: Callable[[Answer], None]) -> None:
        """Something else of the simulator, once nothing is dragged."""
        self._live.also(ask, then)

    def follow(self) -> None:
        """The layout, its model or its target is another one. The simulator begins before the page is drawn."""
        session, target = self._session, self._session.targets.shown
        self.band = None
        self._asked += 1
        self._live.drop(self._band_arrived)
        time = None if target is None else target.loaded.time
        self._live.want(session.layout, session.choice.model, moving=session.moving, time=time)
        self._live.turn()

    def show_again(self) -> None:
        """The target is another one: the shape that is there is compared with it, and not computed again."""
        if self.shown is not None and self.shown.layout == self._session.layout and self._live.at_rest:
            self._came(self.shown)

    @property
    def bands(self) -> bool:
        """Whether the model's intervals make a band around exact shapes at rest."""
        target = self._session.targets.shown
        return bool(self._session.choice.around) and (target is None or target.loaded.time is None)

    def _came(self, shape: LiveShape) -> None:
        self.shown, session = shape, self._session
        if shape.layout == session.layout:
            session.drawings.seen.forget()
            if shape.exact:
                self._keep_exact(shape)
        session.view.show_shape(shape)
        session.view.show_comparison()

    def _keep_exact(self, shape: LiveShape) -> None:
        session, seen = self._session, self._session.drawings.seen
        seen.shape = shape
        if session.targets.shown is not None:
            seen.comparison = compare(session.targets.shown, shape.points, shape.layout.design)
            session.view.show_results()
        if self.bands:
            self._around = []
            for one in session.choice.around:
                ask = Ask.at_rest(self._asked, "nearby", shape.layout.design, shape.layout.pressures, one)
                self._live.also(ask, self._band_arrived)

    def _band_arrived(self, answer: Answer) -> None:
        """One more of the shapes around the one that is shown; with the last there is a band."""
        if answer.number != self._asked or answer.points is None:
            return
        self._around.append(answer.points)
        if len(self._around) == len(self._session.choice.around):
            self.band = Band.of(self._around)
            self._session.view.show_band()
