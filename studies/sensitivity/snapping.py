"""Samples near a bifurcation: small changes of the pressures, to either side, lead to another stable shape.

Chance decides to which side such a cloth buckles, and so its share in an index. A few samples are computed again with
the pressures 2 % higher on the front and lower on the back, and with both signs reversed. A smooth response moves as
far in one direction as in the other; a jump does not.
"""

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.design import Design

Array = NDArray[np.float64]
OFF = 0.02  # of each pressure
ASYMMETRIC = 5e-3  # m RMS over points, of the sum of both moves: beyond a local slope
FAR = 20e-3  # m RMS, of either move: five times what 2 % of pressure moves the steepest sound cloth


def spreads(design: Design) -> tuple[Array, Array]:
    """(channels,) factors on the pressures, of either sign; a channel on both faces counts as front."""
    sign = np.ones(design.channels)
    front = {muscle.channel for muscle in design.muscles if muscle.side == "front"}
    for muscle in design.muscles:
        if muscle.channel not in front:
            sign[muscle.channel] = -1.0
    return 1 + OFF * sign, 1 - OFF * sign


def moved(own: Array, one: Array, other: Array) -> Array:
    """(2,) m RMS over points: the larger move, and the sum of both; of shapes (..., 3) m. NaN where one is."""
    there, back = one - own, other - own
    return np.array([max(_rms(there), _rms(back)), _rms(there + back)])


def snaps(moves: Array) -> NDArray[np.bool_]:
    """Of (n, 2) moves. One that could not be computed counts as a snap."""
    return np.asarray(~((moves[:, 0] < FAR) & (moves[:, 1] < ASYMMETRIC)))


def _rms(shift: Array) -> float:
    return float(np.sqrt(np.square(shift).sum(axis=-1).mean()))
