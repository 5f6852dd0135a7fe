"""Stretches of a trial that hang on less than the data sheet knows: where cloth buckles by a coin's toss.

Equal pressures on both faces of a symmetric layout buckle it either way, and after a snap the way that was taken stays.
No fit can learn from such a stretch and no error there says anything of a model. The model itself says where they are:
small changes, to either side, lead elsewhere.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.forward import PARAMETERS, Case, ForwardModel, Term
from fabdesign.trial import Trial
from studies.calibration.clouds import evenly
from studies.calibration.parameters import PRIOR

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

DRAWS = 4  # the data sheet itself, and draws of its prior
TILT = 0.05  # degrees that gravity is off
PRESSURE = 0.01  # that a channel's pressure is off, either way
INTERVAL = 0.1  # s between the instants that are looked at
APART = 0.003  # m RMS between the motions of changes to either side: they have gone different ways
BENT = 0.0015  # m RMS of what is not proportional in them, where it is over half of what is
SHARE = 0.5  # of the draws, from which on an instant hangs on less than the data sheet knows
GAP = 0.35  # s: unjudged stretches nearer than this are one
WHY = "changes of 0.05 degrees and 1 % of the pressures, to either side, lead elsewhere"
_AT_ONCE = 128  # motions in memory


@dataclass(frozen=True)
class Stretch:
    """An unjudged stretch of a trial, both ends included."""

    trial: str
    begin: float  # s after rest
    end: float  # s
    why: str = WHY

    def as_json(self) -> dict[str, Any]:
        return {"trial": self.trial, "from_s": self.begin, "to_s": self.end, "why": self.why}


def unjudged(
    trials: Sequence[Trial],
    forward: ForwardModel,
    *,
    until: float = np.inf,
    draws: int = DRAWS,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Stretch, ...]:
    """The unjudged stretches of `trials`, in their order: once for a set, from its data sheet alone, whatever model is
    judged later.

    forward: the bare simulator, a coarse grid is enough (21 points a side). until: s of each trial that are looked at.
    Each draw of the factors' prior is simulated as it is and with one small change to either side: gravity tilted and
    every channel's pressure off, by chance up or down. An instant is unjudged where in half of the draws the two
    motions lie 3 mm apart, or differ from the middle one by unequal amounts. `progress` is told motions done and all.
    """
    rng = np.random.default_rng(seed)
    factors = [dict.fromkeys(PARAMETERS, 1.0)]
    factors += [
        {name: float(np.exp(PRIOR[name] * rng.standard_normal())) for name in PARAMETERS} for _ in range(draws - 1)
    ]
    cases: list[Case] = []
    for trial in trials:
        signs = rng.choice([-1.0, 1.0], size=(draws, trial.program.pressure.shape[1]))
        for drawn, sign in zip(factors, signs, strict=True):
            cases += [_changed(trial, drawn, side * sign, side * TILT) for side in (0.0, 1.0, -1.0)]
    times = [instants(trial, until) for trial in trials]
    apart: list[list[Flags]] = [[] for _ in trials]
    per_trial, at_once = 3 * draws, max(1, _AT_ONCE // (3 * draws))
    for first in range(0, len(trials), at_once):
        some = range(first, min(first + at_once, len(trials)))
        batch = cases[first * per_trial : (some[-1] + 1) * per_trial]
        motions = forward.motions(batch, [times[t] for t in some for _ in range(per_trial)])
        for k, t in enumerate(some):
            own = motions[k * per_trial : (k + 1) * per_trial]
            apart[t] = [elsewhere(*own[3 * d : 3 * d + 3]) for d in range(draws)]
        progress((some[-1] + 1) * per_trial, len(cases))
    stretches: list[Stretch] = []
    for trial, when, flags in zip(trials, times, apart, strict=True):
        stretches += _stretches(trial.name, when, np.mean(flags, axis=0) >= SHARE)
    return tuple(stretches)


def judged(stretches: Sequence[Stretch], trial: str, times: Array) -> Flags:
    """(T,) whether each frame of a trial, at `times` [s], is judged."""
    inside = [(s.begin - 1e-9 <= times) & (times <= s.end + 1e-9) for s in stretches if s.trial == trial]
    return ~np.any(inside, axis=0) if inside else np.ones(len(times), dtype=bool)


def share_unjudged(stretches: Sequence[Stretch], trials: Sequence[Trial]) -> float:
    """Of all frames of the trials."""
    kept = [judged(stretches, trial.name, trial.times) for trial in trials]
    return float(1 - np.concatenate(kept).mean()) if kept else 0.0


def said(stretches: Sequence[Stretch], trials: Sequence[Trial]) -> str:
    """In a line for people."""
    if not stretches:
        return "every frame is judged: nowhere do small changes lead elsewhere"
    where = ", ".join(f"{s.trial} {s.begin:.1f} to {s.end:.1f} s" for s in stretches)
    return f"unjudged, {share_unjudged(stretches, trials):.0%} of the frames: {where}; {WHY}"


def instants(trial: Trial, until: float = np.inf) -> Array:
    """(n,) s, of the trial's frames about every INTERVAL s, the first and the last among them."""
    times = trial.times[trial.times <= until + 1e-9]
    times = times if len(times) else trial.times[:1]
    count = max(2, round((times[-1] - times[0]) / INTERVAL) + 1)
    return np.asarray(times[evenly(len(times), count)])


def elsewhere(middle: NDArray[Any], up: NDArray[Any], down: NDArray[Any]) -> Flags:
    """(T,) whether motions (T, n, 3) m with a small change to either side have left the way of the one between; a
    motion that diverged has."""
    plus, minus = up - middle, down - middle
    linear, bent = _rms(plus - minus), _rms(plus + minus)
    sound = np.isfinite(linear) & np.isfinite(bent)
    return ~sound | (linear > APART) | ((bent > BENT) & (bent > 0.5 * linear))


def _rms(difference: NDArray[Any]) -> Array:
    return np.asarray(np.sqrt(np.square(difference, dtype=float).sum(axis=2).mean(axis=1)))


def _changed(trial: Trial, factors: dict[str, float], signs: Array, tilt: float) -> Case:
    program = replace(trial.program, pressure=trial.program.pressure * (1 + PRESSURE * signs))
    effects = (Term("frame_tilt", {"about_x": tilt, "about_z": 0.0}),) if tilt else ()
    return Case(trial.design, program, factors, effects)


def _stretches(trial: str, times: Array, flags: Flags) -> list[Stretch]:
    """Runs of flagged instants, each widened to the instants around it; near ones are one."""
    spans: list[tuple[float, float]] = []
    for k in np.flatnonzero(flags).tolist():
        begin, end = float(times[max(k - 1, 0)]), float(times[min(k + 1, len(times) - 1)])
        if k <= 1:
            begin = 0.0
        if spans and begin - spans[-1][1] < GAP:
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((begin, end))
    return [Stretch(trial, begin, end) for begin, end in spans]
