"""Estimates of what work takes, before it is begun: motions that take too much are bad input, a fit says how long."""

import os
from collections.abc import Iterator, Sequence

from fabdesign.errors import InputError
from fabdesign.runtime import working_time

MEMORY = 2e9  # bytes that a command may need beyond those of the program itself
LONGEST = 3600.0  # s, of a pressure program or a motion
COARSEST, FINEST = 9, 161  # grid points a side
CLOSEST = 0.001  # m between fixed points: stitches are not made closer
MUSCLES = 256  # of a design
_TICKS = 1920  # steps in a second at most
_FACES, _NODE = 120_000, 21  # bytes of a frame: its two faces of 41 x 41 points on the way out, and of each node
_MEANS = 48  # bytes of a channel's pressure while the steps are laid out
_SCHEME = 12 * 4  # bytes of a step's rule
# CPU s of a fit for each second of motion and each unknown, on the grid of that work: rig_d took 60 for 8 trials of
# 1.5 s and 7 unknowns on 41 points a side, and traces of rig_e to rig_h 300 to 380 for 24 s and 49 unknowns on 21
CALIBRATION, TRACE = (0.62, 41, 0.85), (0.3, 21, 0.0)  # the last: share of it that has a grid of its own
# CPU s of an evaluation, and for each second of motion: practice_set (5 s) took 10, two and all trials of rig_d (6 and
# 30 s) 18 and 23
EVALUATION = (10.0, 0.45)
TRAINING = (4.5, 0.65)  # likewise: practice_set (4 s) took 7.4, rig_d (24 s) 20.2
# for a shape and a candidate on this grid: 38 shapes of basic took 40; candidates by the share that the bar gives them
UNSEEN = (1.05, 9.0, 21)
RIG = 300.0  # CPU s for each second of motion and m^2 of cloth: basic under one pressure took 18 for 1.5 s and 0.04 m^2
# CPU s of a muscle's law on a bench, and of a row, left-out record and unknown squared of effects fitted beside it:
# made benches of 4 to 12 records of 500 to 4,000 rows, 3 and 5 unknowns, within a factor 1.4
BENCH_LAW, BENCH_ROW = 0.09, 1.0e-5
_LATE = 0.9  # of the time expected, from which on a bar no longer follows the clock


def frame_bytes(points_per_side: int) -> float:
    """Return the bytes at the peak for a frame of a motion on a grid (measured with 41 and 161 points a side)."""
    return _FACES + _NODE * points_per_side**2


def require_motion(seconds: float, frames: float, points_per_side: int, *, channels: int = 0) -> None:
    """Raise InputError where a motion of `seconds` s, all its `frames` kept, would last or take too much."""
    if seconds > LONGEST:
        raise InputError(f"a motion of {seconds:g} s; expected at most {LONGEST:g} s")
    step = _SCHEME + channels * (4 + _MEANS)  # bytes
    memory = frames * frame_bytes(points_per_side) + seconds * _TICKS * step
    if memory > MEMORY:
        raise InputError(
            f"{frames:.7g} frames in {seconds:g} s with {points_per_side} grid points a side take "
            f"{memory / 1e9:.2g} GB; expected at most {MEMORY / 1e9:g} GB: a shorter time or fewer frames a second"
        )


def batches(frames: Sequence[int], at_once: int) -> Iterator[slice]:
    """Yield slices of motions with so many `frames` each, in order: at most `at_once` together, and of more than one no
    more frames than memory holds on the finest grid."""
    most, first = MEMORY / 2 / frame_bytes(FINEST), 0
    while first < len(frames):
        end = first + 1
        while end < min(len(frames), first + at_once) and sum(frames[first : end + 1]) <= most:
            end += 1
        yield slice(first, end)
        first = end


def duration(seconds: float) -> str:
    """Return a time for people."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def fit_seconds(work: tuple[float, int, float], motion: Sequence[float], unknowns: int, points_per_side: int) -> float:
    """Return about how many seconds a fit takes by the clock on these cores. work: CALIBRATION or TRACE; motion: s of
    each trial."""
    rate, grid, fixed = work
    return rate * (fixed + (1 - fixed) * (points_per_side / grid) ** 2) * sum(motion) * (unknowns + 1) / cores()


def unseen_seconds(shapes: int, candidates: int, points_per_side: int) -> float:
    """Return about how many seconds shapes at rest of drawn models and what so many measurements would tell take."""
    shape, candidate, grid = UNSEEN
    return (shape * shapes + candidate * candidates) * (points_per_side / grid) ** 2 / cores()


def trials_seconds(work: tuple[float, float], motion: Sequence[float]) -> float:
    """Return about how many seconds work on trials takes by the clock on these cores. work: EVALUATION, or TRAINING of
    a corrector of the usual network; motion: s of each trial."""
    fixed, rate = work
    return (fixed + rate * sum(motion)) / cores()


def rig_seconds(motion: float, area: float) -> float:
    """Return about how many seconds a trial takes on the virtual rig, on one core. motion: s; area: m^2, of cloth."""
    return RIG * motion * area


def bench_fit_seconds(records: int, rows: int, unknowns: int) -> float:
    """Return about how many seconds the fit of a muscle's bench takes, on one core. rows: of all records; unknowns: of
    effects."""
    return BENCH_LAW * 3 * (1 + records) + BENCH_ROW * records * rows * (unknowns + (unknowns > 0)) ** 2


def in_words(seconds: float, *what: str) -> str:
    """Return what is about to be done and how long that takes. what: parts of it, such as "8 trials"."""
    rounded = 10 * max(1, round(seconds / 10)) if seconds < 90 else seconds
    return f"{', '.join(what)}: about {duration(rounded)}"


def on_cores() -> str:
    """Return how many cores there are, in words."""
    return "1 core" if cores() == 1 else f"{cores()} cores"


def fit_in_words(trials: int, unknowns: int, seconds: float) -> str:
    """Return what a fit is about to do and how long that takes."""
    return in_words(seconds, f"{trials} trials", f"{unknowns} unknowns", on_cores())


class Pace:
    """The share of work that is done, by the clock, for work that does not know it itself. seconds: expected."""

    def __init__(self, seconds: float) -> None:
        self._begin, self._seconds = working_time.seconds(), seconds

    def share(self) -> float:
        """Return a share that rises evenly, and ever slower where it takes longer than expected."""
        part = (working_time.seconds() - self._begin) / self._seconds
        return part if part < _LATE else 1 - (1 - _LATE) * _LATE / part
