"""Which frames of a trial are used, and which stretches are left out because they are sensitive (near a bifurcation):
the simulator says where small changes to either side lead to another shape.

Equal pressures on both faces of a symmetric layout buckle it to either side, and after a snap the cloth stays there. No
fit can learn from such a stretch, and no error there says anything of a model: calibrate, trace, evaluate and train
leave it out. The search depends on a trial's design and program alone, not on other trials or on the model that is
evaluated. So it is kept in the user's cache, and is made once for a trial.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.formats.json_file import read_json, write_json
from fabdesign.formats.schema import Key
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import PARAMETERS, Case, ForwardModel, Term
from fabdesign.nouns.trial import MeasurementSet, Trial
from fabdesign.runtime.fingerprint import sha256
from fabdesign.runtime.store import read_kept, user_cache
from fabdesign.version import SIMULATOR
from optimize.fit.parameters import PRIOR
from studies.prediction.stability import BENT, LEAST, OF_MOTION, instants_elsewhere, sides

Flags = NDArray[np.bool_]

NONE_USED = """every frame is sensitive, small changes of the inputs lead to another shape; expected trials whose \
pressures decide to which side the cloth bends"""
WHY = "tilting the frame by 0.05 degrees and changing the pressures by 1 % leads to another shape there"


@dataclass(frozen=True)
class Stretch:
    """A sensitive stretch of a trial, which is left out; both ends included."""

    trial: str
    begin: Annotated[float, Key("from_s")]  # s after rest
    end: Annotated[float, Key("to_s")]  # s
    why: str = WHY
    set_name: Annotated[str, Key("set", brief=True)] = ""  # of the trial's set; empty where there is but one

    @property
    def named(self) -> str:
        """Return its name for people."""
        trial = f"{self.set_name}/{self.trial}" if self.set_name else self.trial
        return f"{trial} {self.begin:.1f} to {self.end:.1f} s"


def used_mask(stretches: Sequence[Stretch], trial: str, times: Array, *, set_name: str = "") -> Flags:
    """Return (T,) whether each frame of a trial, at `times` [s], is used. set_name: as in the stretches."""
    of_trial = [s for s in stretches if (s.set_name, s.trial) == (set_name, trial)]
    inside = [(s.begin - 1e-9 <= times) & (times <= s.end + 1e-9) for s in of_trial]
    return ~np.any(inside, axis=0) if inside else np.ones(len(times), dtype=bool)


@dataclass(frozen=True, eq=False)
class UsedFrames:
    """Which frames of the trials of some sets are used. stretches: left out; None where they were not looked for."""

    stretches: Annotated[tuple[Stretch, ...] | None, Key("unjudged")]
    share_left_out: Annotated[float, Key("share_unjudged")]  # of the trials' frames
    several: Annotated[bool, Key("")] = False  # sets: stretches are then named by set and trial

    def at(self, measured: MeasurementSet, trial: Trial) -> Flags:
        """Return (T,) whether each frame of a trial of the set is used."""
        return used_mask(self.stretches or (), trial.name, trial.times, set_name=measured.name if self.several else "")

    @property
    def in_words(self) -> str:
        """Return a line for people."""
        if self.stretches is None:
            return "all frames are used; sensitive stretches were not looked for"
        if not self.stretches:
            return "all frames are used: no stretch is sensitive to small changes of the inputs"
        named = ", ".join(stretch.named for stretch in self.stretches)
        return f"left out as sensitive, {self.share_left_out:.0%} of the frames: {named}; {WHY}"


GRID = 21  # points a side, of the simulator that searches
SCREEN = 2  # draws for every trial: the data sheet itself, and one of its prior
DRAWS = 4  # where one of these finds something
SHARE = 0.5  # of the draws, from which on an instant is sensitive
TILT = 0.05  # degrees that gravity is off
PRESSURE = 0.01  # that a channel's pressure is off, up or down
INTERVAL = 0.1  # s between the instants that are looked at
GAP = 0.35  # s: sensitive stretches nearer than this are one
_SEED = 0
_AT_ONCE = 128  # motions in memory

Span = tuple[float, float]  # s
Progress = Callable[[int, int], None]


def find_used_frames(
    sets: Sequence[tuple[MeasurementSet, Sequence[Trial]]],
    forward: ForwardModel | None,
    *,
    progress: Progress = lambda done, total: None,
) -> UsedFrames:
    """Return the frames used of the trials of each set, from one batch of motions.

    forward: the bare simulator, GRID points a side are enough; without it sensitive stretches are not looked for. Each
    draw of the factors' prior is simulated as it is and with one small change to either side: gravity tilted, and every
    channel's pressure off: of the first draw the front's up and the back's down, of others at random. An instant is
    sensitive where in half of the draws the two motions lie a third of the motion's size apart, or differ from the
    middle one by unequal amounts. Where the first two draws find nothing there are no more. progress is given motions
    done and in all.
    """
    several, trials = len(sets) > 1, [trial for _, some in sets for trial in some]
    if forward is None or not trials:
        return UsedFrames(None if forward is None else (), 0.0, several)
    names = [measured.name if several else "" for measured, some in sets for _ in some]
    stretches = tuple(
        Stretch(trial.name, *span, set_name=name)
        for trial, spans, name in zip(trials, _spans(trials, forward, progress), names, strict=True)
        for span in spans
    )
    used = [used_mask(stretches, t.name, t.times, set_name=name) for t, name in zip(trials, names, strict=True)]
    return UsedFrames(stretches, float(1 - np.concatenate(used).mean()), several)


def _spans(trials: Sequence[Trial], forward: ForwardModel, progress: Progress) -> list[list[Span]]:
    """Return the spans of each trial, kept or searched."""
    files = [_kept(trial, forward) for trial in trials]
    spans = [None if file is None else read_kept(file, _read) for file in files]
    missing = [k for k, spans_of_trial in enumerate(spans) if spans_of_trial is None]
    searched = _search([trials[k] for k in missing], forward, progress)
    for k, stretches in zip(missing, searched, strict=True):
        spans[k] = stretches
        if (file := files[k]) is not None:
            with suppress(InputError):  # a folder that cannot be written: it is searched again
                write_json(file, stretches)
    return [spans_of_trial or [] for spans_of_trial in spans]


def _search(trials: Sequence[Trial], forward: ForwardModel, progress: Progress) -> list[list[Span]]:
    rng, times = np.random.default_rng(_SEED), [instants(trial) for trial in trials]
    draws = [dict.fromkeys(PARAMETERS, 1.0)]  # the same for all trials
    draws += [
        {name: float(np.exp(PRIOR[name] * rng.standard_normal())) for name in PARAMETERS} for _ in range(1, DRAWS)
    ]
    flags: dict[tuple[int, int], Flags] = {}  # of trial and draw, which instants are sensitive

    def look(wanted: Sequence[tuple[int, int]]) -> None:
        at_once, total = max(1, _AT_ONCE // 3), len(flags) + len(wanted)
        for first in range(0, len(wanted), at_once):
            some = wanted[first : first + at_once]
            cases = [_changed(trials[t], draws[d], d, side) for t, d in some for side in (0.0, 1.0, -1.0)]
            motions = forward.motions(cases, [times[t] for t, _ in some for _ in range(3)])
            for k, pair in enumerate(some):
                flags[pair] = instants_elsewhere(*motions[3 * k : 3 * k + 3])
            progress(3 * len(flags), 3 * total)

    look([(t, d) for t in range(len(trials)) for d in range(SCREEN)])
    parted = [t for t in range(len(trials)) if any(flags[t, d].any() for d in range(SCREEN))]
    look([(t, d) for t in parted for d in range(SCREEN, DRAWS)])
    shares = {t: np.mean([flags[t, d] for d in range(DRAWS)], axis=0) for t in parted}
    return [_runs(times[t], shares[t] >= SHARE) if t in shares else [] for t in range(len(trials))]


def _changed(trial: Trial, factors: dict[str, float], draw: int, side: float) -> Case:
    """Return a motion with a change to a side: of the first draw a channel's pressure goes by the side of its muscles,
    else at random."""
    channels = trial.program.pressure.shape[1]
    signs = np.random.default_rng([_SEED, draw]).choice([-1.0, 1.0], channels)
    if not draw:
        of_muscles = np.pad(sides(trial.design), (0, channels - trial.design.channels))
        signs = np.where(of_muscles, of_muscles, signs)
    program = replace(trial.program, pressure=trial.program.pressure * (1 + PRESSURE * side * signs))
    effects = (Term("frame_tilt", {"about_x": TILT * side, "about_z": 0.0}),) if side else ()
    return Case(trial.design, program, factors, effects)


def instants(trial: Trial) -> Array:
    """Return (n,) s of the trial's frames about every INTERVAL s, the first and the last among them."""
    times = trial.times
    count = max(2, round((times[-1] - times[0]) / INTERVAL) + 1)
    return np.asarray(times[np.unique(np.linspace(0, len(times) - 1, min(count, len(times))).round().astype(int))])


def _runs(times: Array, flags: Flags) -> list[Span]:
    """Return runs of flagged instants, each widened to the instants around it; near ones are one."""
    spans: list[Span] = []
    for k in np.flatnonzero(flags).tolist():
        begin, end = float(times[max(k - 1, 0)]), float(times[min(k + 1, len(times) - 1)])
        if k <= 1:
            begin = 0.0
        if spans and begin - spans[-1][1] < GAP:
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((begin, end))
    return spans


def _kept(trial: Trial, forward: ForwardModel) -> Path | None:
    """Return the file with the stretches of a trial; None for a simulator that does not say what it is."""
    if not hasattr(forward, "__dataclass_fields__"):  # its repr is then all that it is
        return None
    searched = SCREEN, DRAWS, SHARE, TILT, PRESSURE, INTERVAL, OF_MOTION, BENT, LEAST, GAP, _SEED
    options = *searched, sorted(PRIOR.items())
    arrays = [np.asarray(array, np.float64) for array in (trial.program.time, trial.program.pressure, trial.times)]
    return user_cache("unjudged") / f"{sha256(repr((SIMULATOR, forward, options, trial.design)), *arrays)[:32]}.json"


def _read(file: Path) -> list[Span]:
    return [(float(begin), float(end)) for begin, end in read_json(file, list)]
