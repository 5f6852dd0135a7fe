"""The search for sensitive stretches: the simulator says where small changes to either side lead to another shape.

The result depends on a trial's design and program alone, not on other trials or on the model that is evaluated. So it
is kept in the user's cache, and one search serves calibrate, evaluate, trace and train.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from fabdesign.errors import InputError
from fabdesign.formats.json_file import read_json, write_json
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import PARAMETERS, Case, ForwardModel, Term
from fabdesign.nouns.trial import MeasurementSet, Trial
from fabdesign.runtime.fingerprint import sha256
from fabdesign.runtime.store import read_kept, user_cache
from fabdesign.version import SIMULATOR
from optimize.fit.parameters import PRIOR
from studies.measured.used_frames import Flags, Stretch, UsedFrames, used_mask
from studies.prediction.stability import BENT, LEAST, OF_MOTION, instants_elsewhere, sides

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
    """Return the frames used of the trials of each set, from one batch of motions. forward: see `sensitive_stretches`;
    without it sensitive stretches are not looked for. progress is given motions done and in all."""
    several, trials = len(sets) > 1, [trial for _, some in sets for trial in some]
    if forward is None or not trials:
        return UsedFrames(None if forward is None else (), 0.0, several)
    spans = _spans(trials, forward, progress)
    names = [measured.name if several else "" for measured, some in sets for _ in some]
    stretches = _named(trials, spans, names)
    used = [used_mask(stretches, t.name, t.times, set_name=name) for t, name in zip(trials, names, strict=True)]
    return UsedFrames(stretches, float(1 - np.concatenate(used).mean()), several)


def sensitive_stretches(
    trials: Sequence[Trial], forward: ForwardModel, *, progress: Progress = lambda done, total: None
) -> tuple[Stretch, ...]:
    """Return the sensitive stretches of the trials of one set, in their order.

    forward: the bare simulator, GRID points a side are enough. Each draw of the factors' prior is simulated as it is
    and with one small change to either side: gravity tilted, and every channel's pressure off: of the first draw the
    front's up and the back's down, of others at random. An instant is sensitive where in half of the draws the two
    motions lie a third of the motion's size apart, or differ from the middle one by unequal amounts. Where the first
    two draws find nothing there are no more. progress is given motions done and in all.
    """
    return _named(trials, _spans(trials, forward, progress), [""] * len(trials))


def _named(trials: Sequence[Trial], spans: Sequence[Sequence[Span]], names: Sequence[str]) -> tuple[Stretch, ...]:
    return tuple(
        Stretch(trial.name, *span, set_name=name)
        for trial, spans_of_trial, name in zip(trials, spans, names, strict=True)
        for span in spans_of_trial
    )


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
    draws = _prior(DRAWS)
    times = [instants(trial) for trial in trials]
    some, total = range(SCREEN), SCREEN * len(trials)
    flags = _sensitive([(t, d) for t in range(len(trials)) for d in some], trials, times, draws, forward, 0, progress)
    parted = [t for t in range(len(trials)) if any(flags[t, d].any() for d in some)]
    rest = [(t, d) for t in parted for d in range(SCREEN, DRAWS)]
    flags |= _sensitive(rest, trials, times, draws, forward, total, progress)
    result: list[list[Span]] = [[] for _ in trials]
    for t in parted:
        share = np.mean([flags[t, d] for d in range(DRAWS)], axis=0)
        result[t] = _runs(times[t], share >= SHARE)
    return result


def _prior(draws: int) -> list[dict[str, float]]:
    """Return the factors of each draw, the same for all trials."""
    rng = np.random.default_rng(_SEED)
    drawn = [{name: float(np.exp(PRIOR[name] * rng.standard_normal())) for name in PARAMETERS} for _ in range(1, draws)]
    return [dict.fromkeys(PARAMETERS, 1.0), *drawn]


def _sensitive(
    wanted: Sequence[tuple[int, int]],
    trials: Sequence[Trial],
    times: Sequence[Array],
    draws: Sequence[dict[str, float]],
    forward: ForwardModel,
    before: int,
    progress: Progress,
) -> dict[tuple[int, int], Flags]:
    """Return the sensitive instants of each (trial, draw); `before` of them are done."""
    flags: dict[tuple[int, int], Flags] = {}
    at_once = max(1, _AT_ONCE // 3)
    for first in range(0, len(wanted), at_once):
        some = wanted[first : first + at_once]
        cases = [_changed(trials[t], draws[d], d, side) for t, d in some for side in (0.0, 1.0, -1.0)]
        motions = forward.motions(cases, [times[t] for t, _ in some for _ in range(3)])
        for k, pair in enumerate(some):
            flags[pair] = instants_elsewhere(*motions[3 * k : 3 * k + 3])
        progress(3 * (before + first + len(some)), 3 * (before + len(wanted)))
    return flags


def _changed(trial: Trial, factors: dict[str, float], draw: int, side: float) -> Case:
    signs = _signs(trial.design, trial.program.pressure.shape[1], draw)
    program = replace(trial.program, pressure=trial.program.pressure * (1 + PRESSURE * side * signs))
    effects = (Term("frame_tilt", {"about_x": TILT * side, "about_z": 0.0}),) if side else ()
    return Case(trial.design, program, factors, effects)


def _signs(design: Design, channels: int, draw: int) -> Array:
    """Return (channels,) 1 or -1, of the first draw by the side of a channel's muscles, else at random."""
    signs = np.random.default_rng([_SEED, draw]).choice([-1.0, 1.0], channels)
    if draw:
        return signs
    sides_of_channels = np.pad(sides(design), (0, channels - design.channels))
    return np.asarray(np.where(sides_of_channels, sides_of_channels, signs))


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
    options = (
        SCREEN,
        DRAWS,
        SHARE,
        TILT,
        PRESSURE,
        INTERVAL,
        OF_MOTION,
        BENT,
        LEAST,
        GAP,
        _SEED,
        sorted(PRIOR.items()),
    )
    arrays = [np.asarray(array, np.float64) for array in (trial.program.time, trial.program.pressure, trial.times)]
    return user_cache("unjudged") / f"{sha256(repr((SIMULATOR, forward, options, trial.design)), *arrays)[:32]}.json"


def _read(file: Path) -> list[Span]:
    return [(float(begin), float(end)) for begin, end in read_json(file, list)]
