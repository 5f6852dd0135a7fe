"""Whether small changes of the inputs lead to another stable shape: the one answer that all studies take.

A smooth response moves as far to one side as to the other, and in proportion to the change; a jump does not. So three
questions: do two shapes that should be one lie far apart; do two changes, one to either side, move a shape by unequal
amounts; and does a copy miss what its derivatives say?
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.design import Design

Array = NDArray[np.float64]
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
    """(channels,) 1 of the front's, -1 of the back's, 0 of those of both."""
    signs = np.zeros(design.channels)
    for muscle in design.muscles:
        signs[muscle.channel] += 1 if muscle.side == "front" else -1
    return np.asarray(np.sign(signs))


def to_either_side(design: Design) -> tuple[Array, Array]:
    """(channels,) factors on the pressures, OFF up on the front and down on the back, and the other way round."""
    signs = sides(design)
    return 1 + OFF * np.where(signs, signs, 1.0), 1 - OFF * np.where(signs, signs, 1.0)


def rms(difference: Points) -> float:
    """m, over all points."""
    return float(np.sqrt(np.square(difference).sum(axis=-1).mean()))


def rms_of_each(difference: Points) -> Array:
    """(...,) m, over the points of each shape."""
    return np.asarray(np.sqrt(np.square(difference, dtype=float).sum(axis=-1).mean(axis=-1)))


def apart(a: Points, b: Points) -> float:
    """m RMS, of the pose where it is most; NaN where one diverged."""
    return float(rms_of_each(a - b).max())


def are_one(distance: float, off_rest: float) -> bool:
    """Return whether shapes `distance` [m RMS] apart are of one branch. off_rest: m RMS that they lie off the cloth at
    rest. A shape that diverged is on none."""
    return distance <= max(LEAST, OF_SHAPE * off_rest)


def moves(own: Points, one: Points, other: Points) -> Array:
    """(2,) m RMS of a shape with changes to either side: the larger move, and the sum of both. NaN where one is."""
    there, back = one - own, other - own
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
    """(T,) whether motions (T, n, 3) m with a small change to either side are on another branch than the middle one; a
    motion that diverged is. At any scale: by the motion's size, the largest RMS distance from where it begins."""
    plus, minus = up - middle, down - middle
    linear, bent = rms_of_each(plus - minus), rms_of_each(plus + minus)
    sound = np.isfinite(linear) & np.isfinite(bent)
    size = max(float(np.nanmax(rms_of_each(middle - middle[0]), initial=0.0)), LEAST)
    return ~sound | (linear > OF_MOTION * size) | ((bent > BENT * size) & (bent > 0.5 * linear))
