"""Trials whose cloth took another stable shape (branch) than the model: what is left if the start differs a little.

Near a bifurcation, the frame's tilt and the cloth's natural curvature decide the side that a cloth buckles to. They are
known only so far, so the branch is a hidden state of the trial: the nearest motion is compared beside the model's own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.metrics import surface_rms
from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import Trial

TILTS = (-2.0, -1.0, 1.0, 2.0)  # deg, about the upper edge
CURLS = (-0.6, -0.3, 0.3, 0.6)  # 1/m, down, beside the model's own
FAR = 3e-3  # m, surface RMS of a trial that no small error explains
HALF = 0.5  # of the error: at most so much is left where the trial is on another branch
_AT_ONCE = 8  # trials


@dataclass(frozen=True)
class Branches:
    """Surface RMS [m] of a trial: of the model's own motion, and of each changed one in the order of `starts`."""

    trial: Trial
    unchanged: float
    others: NDArray[np.float64]

    @property
    def nearest(self) -> float:
        """m, of the changed ones; infinite where all diverged."""
        return float(np.min(self.others, where=np.isfinite(self.others), initial=np.inf))

    @property
    def much_nearer(self) -> bool:
        """Whether a changed start leads to a motion that is much nearer."""
        return self.nearest < HALF * self.unchanged

    @property
    def on_another_branch(self) -> bool:
        """Whether that is so of a trial that no small error explains."""
        return self.unchanged > FAR and self.much_nearer

    @property
    def odds(self) -> float:
        """Share of the starts, the model's own among them, that lead as near as the nearest, within 1 mm."""
        every = np.append(self.others, self.unchanged)
        return float(np.mean(every < np.nanmin(every) + 1e-3))


def starts() -> list[tuple[Term, ...]]:
    """Return what is added to a case: first nothing, then each change."""
    tilts = [(Term("frame_tilt", {"about_x": value}),) for value in TILTS]
    curls = [(Term("rest_curvature", {"down": value}),) for value in CURLS]
    return [(), *tilts, *curls]


def branches_of(trials: Sequence[Trial], forward: Predictor, *, every: int = 1) -> Iterator[Branches]:
    """Yield the branches of each trial, by every so many of its frames. A curvature of the case takes the place of the
    model's own, which is added to it."""
    curvature = next((t.values.get("down", 0.0) for t in forward.model.terms if t.name == "rest_curvature"), 0.0)
    for first in range(0, len(trials), _AT_ONCE):
        some = trials[first : first + _AT_ONCE]
        motions = forward.motions(
            [Case(t.design, t.program, {}, _beside(added, curvature), t.order) for added in starts() for t in some],
            [t.times[::every] for _ in starts() for t in some],
        )
        for k, trial in enumerate(some):
            errors = np.array([_error(trial, motions[k + s * len(some)], every) for s in range(len(starts()))])
            yield Branches(trial, float(errors[0]), errors[1:])


def root_mean_square(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _beside(added: tuple[Term, ...], curvature: float) -> tuple[Term, ...]:
    return tuple(
        replace(t, values={k: v + curvature if k == "down" else v for k, v in t.values.items()}) for t in added
    )


def _error(trial: Trial, motion: NDArray[np.float32], every: int) -> float:
    """Return the root mean square [m] over frames; NaN of a motion that diverged."""
    if not np.isfinite(motion).all():
        return float("nan")
    clouds = trial.load().frames[::every]
    return root_mean_square([surface_rms(cloud, points) for cloud, points in zip(clouds, motion, strict=True)])
