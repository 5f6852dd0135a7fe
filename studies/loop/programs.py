"""The pressure programs that are run on a design: the rise to its own pressures, and a few programs that say what its
model lacks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import PressureProgram, limits, rising_program
from fabdesign.nouns.trial import Role
from fabdesign.study_files.loop_file import LoopStudy

TICK = 0.05  # s, in which a regulator is commanded
NEAR = (0.6, 1.3)  # of the design's own pressures, between which programs about them lie
IDLE = 0.35  # chance that a channel of the others has no pressure
LEAST_SHARE = 0.3  # of the highest pressure, of a channel that has some
_STAIRS = np.array([1, 2, 3, 2, 1, 0]) / 3

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Asked:
    """Trials of a design in the order in which they are run: first a rise to each pose's own pressures."""

    design: Design
    programs: tuple[PressureProgram, ...]
    poses: int  # how many of them are rises
    held_out: int  # the last so many

    def role(self, order: int) -> Role:
        return "test" if order >= len(self.programs) - self.held_out else "fit"


def programs_for(
    study: LoopStudy, design: Design, pressures: Array, times: Sequence[float | None], *, seed: int, last: bool = False
) -> Asked:
    """Return the programs for pressures (poses, channels) Pa, and the targets' times [s], None of a shape at rest.
    last: nothing is learned from what is measured, so that only the rises are asked for."""
    search, rate, trials = study.search, study.rig_limits.rate, study.trials
    rises = [
        rising_program(row, search.rise, search.rise + search.hold) if time is None else constant_program(row, time)
        for row, time in zip(pressures, times, strict=True)
    ]
    others = [] if last else _informative(study, design, pressures[0], np.random.default_rng([search.seed, seed]))
    programs = [*rises, *(within_rate(program, rate) for program in others)]
    return Asked(design, tuple(programs), len(rises), 0 if last else trials.held_out)


def _informative(study: LoopStudy, design: Design, levels: Array, rng: np.random.Generator) -> list[PressureProgram]:
    """Return by turns a step on and off, a staircase up and down, random levels; of pressures about the design's own
    and of any others. Channels differ, so that no trial is near a bifurcation."""
    highest = np.minimum(limits(design), study.highest)
    seconds = study.trials.seconds
    chosen = []
    for number in range(study.trials.number):
        if number % 2 == 0:
            most = np.minimum(levels * rng.uniform(*NEAR, len(levels)), highest)
        else:
            most = highest * np.where(rng.random(len(levels)) < IDLE, 0.0, rng.uniform(LEAST_SHARE, 1.0, len(levels)))
        if not most.any():
            most = LEAST_SHARE * highest
        if number % 3 == 0:
            shares: Array = np.outer([1.0, 0.0], np.ones(len(levels)))
            times = np.array([0.0, 2 * seconds / 3])
        elif number % 3 == 1:
            shares = np.outer(_STAIRS, np.ones(len(levels)))
            times = seconds * np.arange(len(_STAIRS)) / len(_STAIRS)
        else:
            shares = rng.uniform(0.0, 1.0, (3, len(levels)))
            times = seconds * np.arange(3) / 3
        rows = 100.0 * np.round(shares * most / 100.0)  # of a regulator that resolves 0.1 kPa
        chosen.append(PressureProgram(times, rows, seconds))
    return chosen


def within_rate(program: PressureProgram, rate: float) -> PressureProgram:
    """Return the program as a regulator follows it that changes by at most `rate` Pa/s, in ticks."""
    if not np.isfinite(rate):
        return program
    times = np.asarray(TICK * np.arange(max(1, round(program.duration / TICK))), np.float64)
    wanted, at, rows = program.at(times), np.zeros(program.pressure.shape[1]), []
    for row in wanted:
        at = at + np.clip(row - at, -rate * TICK, rate * TICK)
        rows.append(at)
    return PressureProgram.of_rows(times, np.array(rows), duration=program.duration)
