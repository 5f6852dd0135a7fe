"""The shape of the layout that is shown: at once on a coarse grid, and once one lets go the exact one; its distance
from the target, and the band of the model's intervals."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.model import Model
from studies.prediction.stability import LEAST, are_one, rms
from studies.studio.document import Document
from studies.studio.drawings import LiveShape
from studies.studio.layout import Layout
from studies.studio.model_choice import Band
from studies.studio.opening import compare
from studies.studio.solver import Answer, Ask

SNAP = 6.0  # times the motion for a change of this size before, which the cloth does not make without a jump
_SIZE = 0.02, 50e3  # m and Pa: changes that count as alike


class Solves(Protocol):
    """Answers asks: a SolverProcess, or in tests a stand-in."""

    def send(self, ask: Ask) -> None: ...

    def receive(self) -> Answer | None: ...


class Live:
    """Asks for shapes so that only the newest layout counts: what came while the solver was busy is dropped but for the
    last. While a gesture lasts the quick shape is all; afterwards the exact one follows it."""

    def __init__(self, solver: Solves, show: Callable[[LiveShape], None], fail: Callable[[str], None]) -> None:
        self._solver, self._show, self._fail = solver, show, fail
        self._wanted: tuple[Layout, Model, float | None] | None = None
        self._moving = False
        self._stage = "idle"  # what the wanted layout still needs: "follow", "exact" or nothing, "idle"
        self._out: tuple[Ask, Layout] | None = None
        self._number = 0
        self._others: list[tuple[Ask, Callable[[Answer], None]]] = []
        self._other: Callable[[Answer], None] | None = None
        self._jumps = JumpDetector()

    def want(self, layout: Layout, model: Model, *, moving: bool, time: float | None = None) -> None:
        """Want the shape of the newest layout. moving: in the middle of a gesture. time: s after rest, where the exact
        shape is to be a motion's frame under these pressures."""
        if self._wanted is None or self._wanted != (layout, model, time):
            self._stage = "follow"
        elif not moving and self._moving and self._stage == "idle":
            self._stage = "exact"
        self._wanted, self._moving = (layout, model, time), moving

    def also(self, ask: Ask, then: Callable[[Answer], None]) -> None:
        """Ask something else, once nothing is dragged."""
        self._others.append((ask, then))

    def drop(self, then: Callable[[Answer], None]) -> None:
        """Take back what was asked for `then` and is not under way."""
        self._others = [(ask, other) for ask, other in self._others if other != then]

    @property
    def at_rest(self) -> bool:
        """Return whether nothing is asked or to be asked."""
        return self._out is None and self._other is None and self._stage == "idle" and not self._others

    def turn(self) -> None:
        """Take an answer that has come, and ask the next that is due."""
        self._receive()
        if self._out is None and self._other is None:
            self._send()

    def _receive(self) -> None:
        if (self._out is None and self._other is None) or (answer := self._solver.receive()) is None:
            return
        if self._other is not None:
            then, self._other = self._other, None
            then(answer)
            return
        assert self._out is not None
        (ask, layout), self._out = self._out, None
        if answer.points is None or answer.simulated is None:
            self._fail(answer.error or "no shape was found")
            return
        if ask.kind == "exact" and self._wanted is not None and layout != self._wanted[0]:
            return  # another is wanted by now, and followed
        exact, time = ask.kind == "exact", None if ask.times is None else float(ask.times[-1])
        jump, before = None, None
        if time is None:  # a motion's frame is on no branch
            jump, before = self._jumps.of(answer.simulated, layout, exact=exact)
        self._show(
            LiveShape(
                answer.points, layout, exact, answer.points_per_side, answer.seconds, jump, before, time,
                answer.correction,
            )
        )  # fmt: skip

    def _send(self) -> None:
        self._number += 1
        if self._wanted is not None and self._stage == "follow":
            layout, model, _ = self._wanted
            ask = Ask.at_rest(self._number, "follow", layout.design, layout.pressures, model)
            self._stage = "idle" if self._moving else "exact"
        elif self._wanted is not None and self._stage == "exact":
            layout, model, time = self._wanted
            ask = Ask.at_rest(self._number, "exact", layout.design, layout.pressures, model, time)
            self._stage = "idle"
        elif self._others:
            other, self._other = self._others.pop(0)
            self._solver.send(other)
            return
        else:
            return
        self._out = ask, layout
        self._solver.send(ask)


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
        moved = rms(points - last[1])
        self._off = max(self._off, moved)
        change = size_of_change(last[0], layout)
        if exact and change == 0:
            return (None, None) if are_one(moved, self._off) else (moved, last[1])
        if change == 0:
            return None, None
        usual = float(np.median(self._rates)) if self._rates else np.inf
        self._rates = [*self._rates[-8:], moved / change]
        return (moved, last[1]) if moved > max(LEAST, SNAP * usual * change) else (None, None)


def size_of_change(a: Layout, b: Layout) -> float:
    """Return 1 for a corner moved by 20 mm or a pressure by 50 kPa; infinite where muscles are others."""
    if [(m.type, m.side, m.channel, len(m.path)) for m in a.design.muscles] != [
        (m.type, m.side, m.channel, len(m.path)) for m in b.design.muscles
    ]:
        return np.inf
    before, after = ([p for m in x.design.muscles for p in m.path] for x in (a, b))
    corners = float(np.abs(np.subtract(before, after)).max(initial=0.0))
    return corners / _SIZE[0] + float(np.abs(np.subtract(a.pressures, b.pressures)).max(initial=0.0)) / _SIZE[1]


class Shapes(Live):
    """Follows the document. shown: the last shape that came. before: (2 n, 3) m, the one before a jump, until the next
    gesture. band: around `shown`, where it is exact and the model's intervals are known."""

    def __init__(self, document: Document, solver: Solves) -> None:
        super().__init__(solver, self._take, lambda reason: document.tell(reason, bad=True))
        self._document = document
        self.shown: LiveShape | None = None
        self.before: NDArray[np.float32] | None = None
        self.band: Band | None = None
        self._around: list[NDArray[np.float32]] = []  # shapes of which a band is made
        self._asked = 0  # counts what is asked for bands
        document.listeners.append(self._follow)

    @property
    def waiting(self) -> bool:
        """Return whether the simulator computes, or is to."""
        return not self.at_rest

    @property
    def bands(self) -> bool:
        """Return whether the model's intervals make a band around exact shapes at rest."""
        target = self._document.target
        return bool(self._document.choice.around) and (target is None or target.loaded.time is None)

    def _follow(self) -> None:
        """Ask for what the document shows now; a shape that is there already is only compared again."""
        document, target = self._document, self._document.target
        self.band = None
        self._asked += 1
        self.drop(self._take_nearby)
        time = None if target is None else target.loaded.time
        self.want(document.layout, document.choice.model, moving=document.moving, time=time)
        self.turn()
        if self.shown is not None and self.shown.layout == document.layout and self.at_rest:
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
            self.also(ask, self._take_nearby)

    def _take_nearby(self, answer: Answer) -> None:
        """Take one more of the shapes around the one that is shown; with the last there is a band."""
        if answer.number != self._asked or answer.points is None:
            return
        self._around.append(answer.points)
        if len(self._around) == len(self._document.choice.around):
            self.band = Band.of(self._around)
            self._document.show()
