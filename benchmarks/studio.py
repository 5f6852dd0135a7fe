"""How soon the studio's cloth follows a hand: `python -m benchmarks.studio [COUNT]` writes docs/lab/studio.md.

An end of a muscle wanders by a few millimetres a step, as a hand drags it, on a design of eight muscles at half
pressure. Measured is the time from the new layout, as the page's thread hands it to the session, to the shape that is
drawn into the scene, with the simulator in its own process as in `fabdesign studio`. The way to the browser, and what
the browser takes to draw, is not in it.
"""

import contextlib
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.machine import ROOT, commit, processor, write_part
from fabdesign.nouns.catalogue import build
from studies.studio.drawings import LiveShape
from studies.studio.layout import Layout, move_corner
from studies.studio.opening import NEW, Opened, search_limits
from studies.studio.server import Gate, quiet_viser
from studies.studio.solver import SolverProcess
from studies.studio.widgets.page import Page

PAGE = ROOT / "docs" / "lab" / "studio.md"
COUNT = 200  # drags, and shapes once let go
STEP = 0.003  # m, standard deviation of a step of the hand
WALK = 0.012  # m, that the hand stays about where it began


class TimedStudio:
    """A studio whose loop runs until a shape is drawn."""

    def __init__(self, server: Any, worker: SolverProcess, layout: Layout) -> None:
        self.page = Page(server, Opened(NEW, layout, search_limits(layout.design)), worker)
        self.shapes: list[LiveShape] = []

        self._run(self.page.begin, layout, exact=True)  # compiles

    def follow(self, layout: Layout) -> float:
        """s from a moment of a drag to its shape."""
        return self._run(lambda: self.page.session.document.drag("drag", layout), layout, exact=False)

    def let_go(self, layout: Layout) -> float:
        """s from the end of a drag to the exact shape."""
        return self._run(lambda: self.page.session.document.drag("drag", layout, last=True), layout, exact=True)

    def _run(self, hand: Callable[[], None], layout: Layout, *, exact: bool) -> float:
        begin, before = time.perf_counter(), len(self.shapes)
        self.page.post(hand)
        while not any(shape.exact == exact and shape.layout == layout for shape in self.shapes[before:]):
            self.page.turn()
            shape = self.page.session.shapes.shown
            if shape is not None and shape not in self.shapes[-1:]:
                self.shapes.append(shape)
        return time.perf_counter() - begin


def layouts(count: int) -> list[Layout]:
    """Where the hand goes."""
    rng = np.random.default_rng(1)
    begin = Layout.of(build("basic"), (200e3, 150e3, 100e3, 200e3, 50e3, 0.0, 0.0, 50e3))
    offsets = np.zeros((count, 2))
    for k in range(1, count):
        step = offsets[k - 1] + rng.normal(0.0, STEP, 2)
        offsets[k] = np.clip(2 * np.clip(step, -WALK, WALK) - step, -WALK, WALK)  # never in one place twice
    u, v = begin.design.muscles[1].path[1]
    return [move_corner(begin, 1, 1, (u + float(du), v - abs(float(dv)))) for du, dv in offsets]


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else COUNT
    hand = layouts(2 * count + 1)
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        stack.enter_context(contextlib.chdir(folder))  # where the autosave goes
        worker = stack.enter_context(contextlib.closing(SolverProcess()))
        gate = stack.enter_context(contextlib.closing(Gate("127.0.0.1", None)))
        timed = TimedStudio(stack.enter_context(quiet_viser(gate)), worker, hand[0])
        before = cpu_seconds()
        follow = [timed.follow(layout) for layout in hand[1 : count + 1]]
        cost = (cpu_seconds() - before) / count
        exact = []
        for layout in hand[count + 1 :]:
            timed.follow(layout)
            exact.append(timed.let_go(layout))
    off = [
        1e3 * float(np.sqrt(np.square(a.points - b.points).sum(axis=-1).mean()))
        for a, b in zip(timed.shapes, timed.shapes[1:], strict=False)
        if not a.exact and b.exact and a.layout == b.layout
    ]
    figures = page(np.array(follow), np.array(exact), np.array(off), cost)
    print(figures)
    write_part(PAGE, "studio", figures)


def cpu_seconds() -> float:
    """Of this process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def page(follow: np.ndarray, exact: np.ndarray, off: np.ndarray, cost: float) -> str:
    def row(name: str, seconds: np.ndarray) -> str:
        median, worst, rate = 1e3 * np.median(seconds), 1e3 * seconds.max(), 1 / np.median(seconds)
        return f"| {name} | {median:.0f} | {1e3 * np.percentile(seconds, 90):.0f} | {worst:.0f} | {rate:.1f} |"

    load = os.getloadavg()[0]
    return "\n".join([
        f"`python -m benchmarks.studio` on commit {commit(PAGE)}, {processor()}, {os.cpu_count()} cores, load average "
        f"{load:.0f} while it ran.",
        f"An end of one of eight muscles is dragged {len(follow)} times by some {1e3 * STEP:g} mm, then "
        f"{len(exact)} times more and let go. From the new layout to its shape in the scene, ms; what the browser "
        "takes to draw it is not in it:",
        "",
        "| shape | median | 90 % | worst | a second |",
        "|---|---|---|---|---|",
        row("followed, 21 points, from the shape before", follow),
        row("exact, 41 points, from rest", exact),
        "",
        f"Of a followed frame {1e3 * cost:.0f} ms of CPU time are the page's (limits, flat view, meshes); the rest is "
        "the simulator's, in its own process beside it.",
        "",
        f"A followed shape lies {np.median(off):.2f} mm RMS (worst {off.max():.2f}) from the exact one: the grid's "
        "error, and what four long steps leave.",
        "",
    ])  # fmt: skip


if __name__ == "__main__":
    main()
