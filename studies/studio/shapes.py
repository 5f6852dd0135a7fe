"""The shape of the layout that is shown: at once on a coarse grid, and once one lets go the exact one; its distance
from the target, and the band of the model's intervals."""

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.nouns.array import Array
from fabdesign.nouns.model import Model
from studies.prediction.stability import LEAST, are_one, rms
from studies.studio.document import Document
from studies.studio.drawings import LiveShape
from studies.studio.layout import Layout
from studies.studio.model_choice import half_band
from studies.studio.opening import Comparison
from studies.studio.solver import Answer, Ask

SNAP = 6.0  # times the motion for a change of this size before, which the cloth does not make without a jump
_SIZE = 0.02, 50e3  # m and Pa: changes that count as alike
Then = Callable[[Answer], None]


class Shapes:
    """Asks for shapes so that only the newest layout counts: what came while the solver was busy is dropped but for the
    last. While a gesture lasts the quick shape is all; afterwards the exact one follows it. What else is asked waits
    until nothing is dragged.

    solver: a SolverProcess, or what sends and receives like one. shown: the last shape that came. before: (2 n, 3) m,
    the one before a jump, until the next gesture. band: (n, 3) m to either side of the lower edge of `shown`, where it
    is exact and the model's intervals are known."""

    def __init__(self, document: Document, solver: Any) -> None:
        self._document, self._solver = document, solver
        self.shown: LiveShape | None = None
        self.before: NDArray[np.float32] | None = None
        self.band: Array | None = None
        self._wanted: tuple[Layout, Model, float | None] | None = None  # the last: s after rest, of a motion's frame
        self._moving = False
        self._stage: Literal["idle", "follow", "exact"] = "idle"  # what is still to be asked of what is wanted
        self._then: Then | None = None  # takes the answer that is awaited
        self._others: list[tuple[Ask, Then]] = []
        self._around: list[NDArray[np.float32]] = []  # shapes of which a band is made
        self._jumps = JumpDetector()
        document.listeners.append(self._follow)

    def also(self, ask: Ask, then: Then) -> None:
        """Ask something else, once nothing is dragged. Of the programs under edit the newest counts."""
        self._others = [pair for pair in self._others if ask.wanted is None or pair[0].wanted is None]
        self._others.append((ask, then))
        self._send()

    @property
    def waiting(self) -> bool:
        """Return whether the simulator computes, or is to."""
        return self._then is not None or self._stage != "idle" or bool(self._others)

    @property
    def bands(self) -> bool:
        """Return whether the model's intervals make a band around exact shapes at rest."""
        return bool(self._document.choice.around) and self._time is None

    @property
    def _time(self) -> float | None:
        """Return s after rest, where the target is of a motion's frame."""
        target = self._document.target
        return None if target is None else target.time

    def turn(self) -> None:
        """Take an answer that has come, and ask the next that is due. Raises InputError for one without what was
        asked; the next is then due at the next turn."""
        if self._then is not None and (answer := self._solver.receive()) is not None:
            then, self._then = self._then, None
            then(answer)
        self._send()

    def _send(self) -> None:
        if self._then is not None:
            return
        if self._stage != "idle" and self._wanted is not None:
            layout, model, time = self._wanted
            ask = Ask.at_rest(self._stage, layout.design, layout.pressures, model, time)
            self._stage = "idle" if self._stage == "exact" or self._moving else "exact"
            self._then = partial(self._take, ask, layout)
        elif self._others:
            ask, self._then = self._others.pop(0)
        else:
            return
        self._solver.send(ask)

    def _follow(self) -> None:
        """Ask for what the document shows now; a shape that is there already is only compared again."""
        document, moving = self._document, self._document.history.gesture is not None
        wanted = document.layout, document.choice.model, self._time
        if self._wanted is None or self._wanted != wanted:
            self._stage = "follow"
        elif not moving and self._moving and self._stage == "idle":
            self._stage = "exact"
        self._wanted, self._moving = wanted, moving
        self.band, self._around = None, []
        self._others = [(ask, then) for ask, then in self._others if ask.kind != "nearby"]
        self._send()
        if self.shown is not None and self.shown.layout == document.layout and not self.waiting:
            self._use(self.shown)

    def _take(self, ask: Ask, layout: Layout, answer: Answer) -> None:
        """Show a shape that has come, unless another exact one is wanted by now."""
        document, exact = self._document, ask.kind == "exact"
        if answer.points is None:
            raise InputError(answer.error)
        if exact and self._wanted is not None and layout != self._wanted[0]:
            return
        time = None if ask.times is None else float(ask.times[-1])
        jump, before = None, None
        if time is None:  # a motion's frame is on no branch
            simulated = answer.points if answer.correction is None else answer.correction.simulated
            jump, before = self._jumps.of(simulated, layout, exact=exact)
        self.shown = shape = LiveShape(
            answer.points, layout, exact, ask.points_per_side, answer.seconds, jump, time, answer.correction
        )
        if jump is not None or document.history.gesture:
            self.before = before
        if layout == document.layout:
            document.seen.forget()
            self._use(shape)
        document.show()

    def _use(self, shape: LiveShape) -> None:
        """Compare an exact shape with the target, and ask for the band around it."""
        document, seen = self._document, self._document.seen
        if not shape.exact:
            return
        seen.live = shape
        if document.target is not None and seen.comparison is None:
            seen.comparison = Comparison.of(document.target, shape.points, shape.layout.design)
        self._around = []
        for model in document.choice.around if self.bands else ():
            ask = Ask.at_rest("nearby", shape.layout.design, shape.layout.pressures, model)
            self.also(ask, partial(self._take_nearby, self._around))

    def _take_nearby(self, around: list[NDArray[np.float32]], answer: Answer) -> None:
        """Take one more of the shapes around the one that is shown; with the last there is a band."""
        if around is not self._around or answer.points is None:
            return
        around.append(answer.points)
        if len(around) == len(self._document.choice.around):
            self.band = half_band(around)
            self._document.show()


class JumpDetector:
    """Tells a jump to another stable shape from a motion that keeps pace with what is dragged.

    A followed shape has jumped where it moved by more than LEAST, and SNAP times as far as the last changes of
    its size moved it. The exact shape is another one than the followed where they lie as far apart as branches do.
    """

    def __init__(self) -> None:
        self._last: tuple[Layout, NDArray[np.float32]] | None = None
        self._rates: list[float] = []  # m for a change of size 1
        self._off = 0.0  # m, the largest that any shape lay off the first

    def of(
        self, points: NDArray[np.float32], layout: Layout, *, exact: bool
    ) -> tuple[float | None, NDArray[np.float32] | None]:
        """Return m RMS of a jump and the shape before it, or neither."""
        last, self._last = self._last, (layout, points)
        if last is None or last[1].shape != points.shape:
            return None, None
        moved, change = rms(points - last[1]), size_of_change(last[0], layout)
        self._off = max(self._off, moved)
        if change == 0:
            jumped = exact and not are_one(moved, self._off)
        else:
            usual = float(np.median(self._rates)) if self._rates else np.inf
            self._rates = [*self._rates[-8:], moved / change]
            jumped = moved > max(LEAST, SNAP * usual * change)
        return (moved, last[1]) if jumped else (None, None)


def size_of_change(a: Layout, b: Layout) -> float:
    """Return 1 for a corner moved by 20 mm or a pressure by 50 kPa; infinite where muscles are others."""
    if [(m.type, m.side, m.channel, len(m.path)) for m in a.design.muscles] != [
        (m.type, m.side, m.channel, len(m.path)) for m in b.design.muscles
    ]:
        return np.inf
    before, after = ([p for m in x.design.muscles for p in m.path] for x in (a, b))
    corners = float(np.abs(np.subtract(before, after)).max(initial=0.0))
    return corners / _SIZE[0] + float(np.abs(np.subtract(a.pressures, b.pressures)).max(initial=0.0)) / _SIZE[1]
