"""The program under edit, whose motion is played over a target that moves."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.files.pressure_file import write_pressures
from fabdesign.output import new_files
from fabdesign.units import in_mm
from studies.follow.programs import case_of
from studies.studio.document import Document
from studies.studio.measured import TrialMotion
from studies.studio.playing import Playing
from studies.studio.shapes import Shapes
from studies.studio.solver import Answer, Ask, Kind
from studies.studio.target import MovingProgram

Array = NDArray[np.float64]
KNOTS = 0.1  # s between two, or a cycle where that is longer


class ProgramEdit:
    """A program under edit. pressures: (cycles, channels) Pa. channel, knot: which are edited; a knot is a set point,
    and those between it and its neighbours move with it. off: (T,) m of the motion that is shown; first: of the first
    one, under the program as it was opened."""

    def __init__(self, moving: MovingProgram, document: Document, shapes: Shapes, playing: Playing) -> None:
        self.moving, self.pressures = moving, moving.pressures
        self._document, self._shapes, self._playing = document, shapes, playing
        self._under_way = False
        self.channel, self.knot = 0, 0
        self.off: Array | None = None
        self.first: Array | None = None

    @property
    def _each(self) -> int:
        """Cycles from one knot to the next."""
        return max(1, round(KNOTS / self.moving.regulator.cycle))

    @property
    def knots(self) -> NDArray[np.intp]:
        """Return the cycles that knots begin."""
        return np.arange(0, len(self.pressures), self._each)

    @property
    def pressure(self) -> float:
        """Return Pa of the knot under edit."""
        return float(self.pressures[self.knots[self.knot], self.channel])

    def select(self, channel: int, knot: int) -> None:
        self.channel, self.knot = channel, min(knot, len(self.knots) - 1)
        self._document.show()

    def put(self, pressure: float) -> None:
        """Give the knot under edit a pressure [Pa], as far as the regulator goes with it, and simulate again."""
        row, rows = int(self.knots[self.knot]), self.pressures.copy()
        share = np.maximum(0.0, 1 - np.abs(np.arange(len(rows)) - row) / self._each)
        if row == self.knots[-1]:
            share[row:] = 1.0  # to the end
        rows[:, self.channel] += (pressure - rows[row, self.channel]) * share
        self.take(self.moving.regulator.kept(rows))

    def take(self, pressures: Array) -> None:
        """Take other set points (cycles, channels) Pa."""
        self.pressures = pressures
        self._document.show()
        self.play()

    def play(self, *, exact: bool = False) -> None:
        """Simulate the program, and play it over the target. exact: on the model's grid, with its corrector."""
        document, moving, design = self._document, self.moving, self._document.layout.design
        if self._under_way and not exact:
            return  # what is under way asks again
        with document.refusals():
            if design.channels != moving.regulator.channels:
                raise InputError(
                    f"{design.name}: {design.channels} channels; the program has {moving.regulator.channels}"
                )
            case = case_of(moving.study, moving.regulator.program(self.pressures))
            kind: Kind = "motion" if exact else "program"
            ask = Ask(
                0, kind, design, case.program, document.choice.model, moving.times, case.order,
                effects=case.effects, wanted=moving.wanted,
            )  # fmt: skip
            self._under_way = True
            self._shapes.also(ask, lambda answer: self._arrived(ask, answer))

    def _arrived(self, ask: Ask, answer: Answer) -> None:
        document, self._under_way = self._document, False
        if (ask.design, ask.model) != (document.layout.design, document.choice.model):
            return  # others by now, and the motion was stopped
        if answer.points is None or answer.off is None:
            document.tell(answer.error or "no motion", bad=True)
            return
        self.off = answer.off
        self.first = self.off if self.first is None else self.first
        name, times, clouds = f"{answer.points_per_side} points a side", self.moving.times, self.moving.clouds
        self._playing.show(TrialMotion(name, times, answer.points, clouds, answer.correction, answer.off), ask)
        if not np.array_equal(ask.program.pressure, self.pressures):
            self.play()
        else:
            mean = in_mm(float(np.nanmean(answer.off)))
            document.tell(f"{mean:.2f} mm from the target, {answer.seconds:.1f} s of computing")

    def save(self, path: Path, *, replace: bool = False) -> None:
        """Write the program, set points at the regulator's cycle."""
        with self._document.refusals():
            with new_files(path, force=replace) as unfinished:
                write_pressures(self.moving.regulator.program(self.pressures), unfinished)
            self._document.tell(f"wrote {path}")
