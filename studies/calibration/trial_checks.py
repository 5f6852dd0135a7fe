"""This module finds what is wrong with a whole trial, against the fitted motion: faces swapped, a clock of its own."""

from collections.abc import Sequence

import numpy as np

from fabdesign.geometry.metrics import surface_rms
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import ForwardModel
from fabdesign.units import in_mm
from optimize.fit.clouds import Motion, Sample, evenly
from optimize.fit.fitted import Fit

DISAGREE = 0.003  # m RMS, under which nothing is asked
BETTER = 0.5  # what another reading must leave of it
FRAMES = 10  # of a trial
LAGS = np.arange(-4, 5) * 0.05  # s
TURNED = {"front and back": (1, 1, -1), "front and back, seen from behind": (-1, 1, -1)}


def implausible(fit: Fit, samples: Sequence[Sample], forward: ForwardModel) -> dict[int, str]:
    """Return a line on each sample that cannot be what its file says, by index. A lag that all trials share is not the
    clock's fault but an effect; motions that diverge are left out."""
    if not (fit.by_trial > DISAGREE).any():
        return {}
    frames = [evenly(len(s.times), FRAMES) for s in samples]
    instants = [np.clip(s.times[chosen] + LAGS[:, None], 0.0, None) for s, chosen in zip(samples, frames, strict=True)]
    motions = forward.motions(
        [fit.vector.case(s.trial, fit.x) for s in samples], [np.unique(times) for times in instants]
    )
    errors = np.full((len(samples), len(LAGS)), np.nan)
    lines: dict[int, str] = {}
    for k, (sample, chosen, times, motion) in enumerate(zip(samples, frames, instants, motions, strict=True)):
        if not np.isfinite(motion).all():
            continue
        clouds = [sample.clouds[f] for f in chosen]
        shapes = motion[np.searchsorted(np.unique(times), times)]  # (lags, frames, 2 n, 3)
        errors[k] = [_rms(clouds, shape) for shape in shapes]
        now = errors[k].min()  # at whatever lag the faces as they are fit best
        if now <= DISAGREE:
            continue
        for name, signs in TURNED.items():
            turned = _rms([cloud * signs for cloud in clouds], shapes[len(LAGS) // 2])
            if turned < BETTER * now:
                lines[k] = (
                    f"{sample.trial.file}: {in_mm(now):.1f} mm RMS off the fitted motion, {in_mm(turned):.1f} with "
                    f"{name} exchanged; expected the front at +z (or did a symmetric cloth buckle to the other side?)"
                )
                break
    return lines | _late(samples, errors, lines)


def _late(samples: Sequence[Sample], errors: Array, known: dict[int, str]) -> dict[int, str]:
    compared = [k for k in range(len(samples)) if k not in known and np.isfinite(errors[k]).all()]
    if len(compared) < 3:
        return {}
    best = errors[compared].argmin(axis=1)
    usual = int(np.median(best))
    lines = {}
    for k, lag in zip(compared, best, strict=True):
        now, then = errors[k, usual], errors[k, lag]
        if now > DISAGREE and then < BETTER * now and abs(lag - usual) > 1:  # one lag is no clock
            lines[k] = (
                f"{samples[k].trial.file}: agrees with the fitted motion {abs(LAGS[lag] - LAGS[usual]):.2f} s "
                f"{'later' if lag > usual else 'earlier'} than the other trials do ({in_mm(then):.1f} instead of "
                f"{in_mm(now):.1f} mm RMS); its clock differs"
            )
    return lines


def _rms(clouds: Sequence[Array], shapes: Motion) -> float:
    return float(np.sqrt(np.mean([surface_rms(c, shape) ** 2 for c, shape in zip(clouds, shapes, strict=True)])))
