"""Whether small changes of the inputs lead to another stable shape: the one answer that all studies take.

A smooth response moves as far to one side as to the other, and in proportion to the change; a jump does not. So three
questions: do two shapes that should be one lie far apart; do two changes, one to either side, move a shape by unequal
amounts; and does a copy miss what its derivatives say?

Trials whose cloth took another stable shape (branch) than the model: what is left if the start differs a little.

Near a bifurcation, the frame's tilt and the cloth's natural curvature decide the side that a cloth buckles to. They are
known only so far, so the branch is a hidden state of the trial: the nearest motion is compared beside the model's own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.metrics import surface_rms
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import Trial

Points = NDArray[np.floating]  # (..., n, 3) m

OFF = 0.02  # of each pressure, up on one face and down on the other: what a regulator may be off
LEAST = 5e-3  # m RMS: two shapes that lie nearer are one, whatever they differ by
OF_SHAPE = 0.15  # of what a shape lies off the cloth at rest: farther apart, two are of different branches
OF_COPY = 0.5  # of a copy's change from the nominal shape, by which it misses what derivatives say
OF_COPIES = 3.0  # times the median copy's change, where derivatives do not hold
STEEPEST = 20e-3  # m RMS by which OFF moves a shape: five times what it moves the steepest sound cloth
OF_MOTION = 0.35  # of a motion's size, between the motions of changes to either side
BENT = 0.05  # of it, what is not proportional in them, where that is over half of what is


def sides(design: Design) -> Array:
    """Return (channels,) 1 of the front's, -1 of the back's, 0 of those of both."""
    signs = np.zeros(design.channels)
    for muscle in design.muscles:
        signs[muscle.channel] += 1 if muscle.side == "front" else -1
    return np.asarray(np.sign(signs))


def to_either_side(design: Design) -> tuple[Array, Array]:
    """Return (channels,) factors on the pressures, OFF up on the front and down on the back, and the other way
    round."""
    signs = sides(design)
    return 1 + OFF * np.where(signs, signs, 1.0), 1 - OFF * np.where(signs, signs, 1.0)


def rms(difference: Points) -> float:
    """Return m, over all points."""
    return float(np.sqrt(np.square(difference).sum(axis=-1).mean()))


def rms_of_each(difference: Points) -> Array:
    """Return (...,) m, over the points of each shape."""
    return np.asarray(np.sqrt(np.square(difference, dtype=float).sum(axis=-1).mean(axis=-1)))


def apart(a: Points, b: Points) -> float:
    """Return m RMS, of the pose where it is most; NaN where one diverged."""
    return float(rms_of_each(a - b).max())


def are_one(distance: float, off_rest: float) -> bool:
    """Return whether shapes `distance` [m RMS] apart are of one branch. off_rest: m RMS that they lie off the cloth at
    rest. A shape that diverged is on none."""
    return distance <= max(LEAST, OF_SHAPE * off_rest)


def moves(nominal: Points, one: Points, other: Points) -> Array:
    """Return (2,) m RMS of a shape with changes to either side: the larger move, and the sum of both. NaN where one
    is."""
    there, back = one - nominal, other - nominal
    return np.array([max(rms(there), rms(back)), rms(there + back)])


def snaps(moved: Array) -> NDArray[np.bool_]:
    """Return of (n, 2) `moves` which are jumps. One that could not be computed counts as one."""
    return np.asarray(~((moved[:, 0] < STEEPEST) & (moved[:, 1] < LEAST)))


def copies_elsewhere(copies: Sequence[Points], predicted: Sequence[Points] | None, nominal: Points) -> int:
    """Return how many copies are on another branch than the nominal shape, or on none. predicted: how derivatives say
    that they move; None where these do not hold."""
    changes = np.array([rms(copy - nominal) for copy in copies])
    if predicted is None:
        sound = changes[np.isfinite(changes)]
        return int(sum(~(changes <= max(LEAST, OF_COPIES * np.median(sound) if len(sound) else 0.0))))
    misses = [rms(copy - nominal - by) for copy, by in zip(copies, predicted, strict=True)]
    return int(sum(~(np.array(misses) <= np.maximum(LEAST, OF_COPY * changes))))


def instants_elsewhere(middle: Points, up: Points, down: Points) -> NDArray[np.bool_]:
    """Return (T,) whether motions (T, n, 3) m with a small change to either side are on another branch than the middle
    one; a motion that diverged is. At any scale: by the motion's size, the largest RMS distance from where it
    begins."""
    plus, minus = up - middle, down - middle
    linear, bent = rms_of_each(plus - minus), rms_of_each(plus + minus)
    sound = np.isfinite(linear) & np.isfinite(bent)
    size = max(float(np.nanmax(rms_of_each(middle - middle[0]), initial=0.0)), LEAST)
    return ~sound | (linear > OF_MOTION * size) | ((bent > BENT * size) & (bent > 0.5 * linear))


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
    others: Array

    @property
    def nearest(self) -> float:
        """Return m, of the changed ones; infinite where all diverged."""
        return float(np.min(self.others, where=np.isfinite(self.others), initial=np.inf))

    @property
    def is_nearer(self) -> bool:
        """Return whether a changed start leads to a motion that is much nearer."""
        return self.nearest < HALF * self.unchanged

    @property
    def on_another_branch(self) -> bool:
        """Return whether that is so of a trial that no small error explains."""
        return self.unchanged > FAR and self.is_nearer

    @property
    def odds(self) -> float:
        """Return the share of the starts, the model's own among them, that lead as near as the nearest, within 1 mm."""
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


def _beside(added: tuple[Term, ...], curvature: float) -> tuple[Term, ...]:
    return tuple(
        replace(t, values={k: v + curvature if k == "down" else v for k, v in t.values.items()}) for t in added
    )


def _error(trial: Trial, motion: NDArray[np.float32], every: int) -> float:
    """Return the root mean square [m] over frames; NaN of a motion that diverged."""
    if not np.isfinite(motion).all():
        return float("nan")
    clouds = trial.load().frames[::every]
    each = [surface_rms(cloud, points) for cloud, points in zip(clouds, motion, strict=True)]
    return float(np.sqrt(np.mean(np.square(each))))
