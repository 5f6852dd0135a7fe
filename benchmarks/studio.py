"""How soon the studio's cloth follows a hand: `python -m benchmarks.studio [COUNT]` writes docs/results/studio.md.

An end of a muscle wanders by a few millimetres a step, as a hand drags it, on a design of eight muscles at half
pressure. Measured is the time from the new layout to the shape that is handed to the page, with the simulator in its
own process as in `fabdesign studio`; what the browser takes to draw it is not in it.
"""

import os
import sys
import time

import numpy as np

from benchmarks.machine import ROOT, commit, processor
from fabdesign.catalogue import build
from fabdesign.model import Model
from studies.studio.layout import Layout, move_corner
from studies.studio.live import Live, LiveShape
from studies.studio.solver import SolverProcess

PAGE = ROOT / "docs" / "results" / "studio.md"
COUNT = 200  # drags of each kind
STEP = 0.003  # m, standard deviation of a step of the hand
WALK = 0.012  # m, that the hand stays about where it began


class TimedStep:
    """Live with a worker, waited for."""

    def __init__(self) -> None:
        self.worker, self.shapes = SolverProcess(), list[LiveShape]()
        self.live = Live(self.worker, self.shapes.append, self._failed)

    def _failed(self, reason: str) -> None:
        raise RuntimeError(reason)

    def until(self, layout: Layout, *, moving: bool, exact: bool) -> float:
        """s from asking for the layout to its shape."""
        begin, before = time.perf_counter(), len(self.shapes)
        self.live.want(layout, Model(), moving=moving)
        while not any(shape.exact == exact and shape.layout == layout for shape in self.shapes[before:]):
            self.live.turn()
            self.worker.connection.poll(0.02)
        return time.perf_counter() - begin


def layouts(count: int) -> list[Layout]:
    """Where the hand goes."""
    rng = np.random.default_rng(1)
    begin = Layout.of(build("basic"), (200e3, 150e3, 100e3, 200e3, 50e3, 0.0, 0.0, 50e3))
    offsets = np.zeros((count, 2))
    for k in range(1, count):
        offsets[k] = np.clip(offsets[k - 1] + rng.normal(0.0, STEP, 2), -WALK, WALK)
    u, v = begin.design.muscles[1].path[1]
    return [move_corner(begin, 1, 1, (u + float(du), v - abs(float(dv)))) for du, dv in offsets]


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else COUNT
    timed = TimedStep()
    try:
        hand = layouts(count)
        timed.until(hand[0], moving=False, exact=True)  # compiles
        follow, exact = [], []
        for layout in hand[1:]:
            follow.append(timed.until(layout, moving=True, exact=False))
            exact.append(timed.until(layout, moving=False, exact=True))
    finally:
        timed.worker.close()
    off = [
        1e3 * float(np.sqrt(np.square(a.points - b.points).sum(axis=-1).mean()))
        for a, b in zip(timed.shapes, timed.shapes[1:], strict=False)
        if not a.exact and b.exact and a.layout == b.layout
    ]
    PAGE.write_text(page(np.array(follow), np.array(exact), np.array(off)), encoding="utf-8")
    print(PAGE.read_text(encoding="utf-8"))


def page(follow: np.ndarray, exact: np.ndarray, off: np.ndarray) -> str:
    def row(name: str, seconds: np.ndarray) -> str:
        median, worst, rate = 1e3 * np.median(seconds), 1e3 * seconds.max(), 1 / np.median(seconds)
        return f"| {name} | {median:.0f} | {1e3 * np.percentile(seconds, 90):.0f} | {worst:.0f} | {rate:.1f} |"

    load = os.getloadavg()[0]
    return "\n".join([
        "# How soon the studio follows",
        "",
        f"`python -m benchmarks.studio` on commit {commit(PAGE)}, {processor()}, {os.cpu_count()} cores, load average "
        f"{load:.0f} while it ran.",
        f"An end of one of eight muscles is dragged {len(follow)} times by some {1e3 * STEP:g} mm. From the new layout "
        "to its shape, ms:",
        "",
        "| shape | median | 90 % | worst | a second |",
        "|---|---|---|---|---|",
        row("followed, 21 points, from the shape before", follow),
        row("exact, 41 points, from rest", exact),
        "",
        f"A followed shape lies {np.median(off):.2f} mm RMS (worst {off.max():.2f}) from the exact one: the grid's "
        "error, and what four long steps leave.",
        "",
    ])  # fmt: skip


if __name__ == "__main__":
    main()
