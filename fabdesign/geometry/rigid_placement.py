"""A target that may stand anywhere: the rigid motion that brings a shape of the cloth nearest to it.

Iterated closest points (Besl and McKay, A method for registration of 3-D shapes, IEEE PAMI 14, 1992), each point
matched with the nearest of the other cloud, and the turn by singular values (Kabsch 1976). It begins where the target
was placed, with both centres on each other, so that a shape has one answer; a turn of more than some 60 degrees from
there it may not find.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]

SOME = 400  # points of either cloud: the motion of a sheet is known from few
ROUNDS = 60
STILL = 1e-7  # m, RMS, by which a further round moves less is the last


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """x -> turn x + shift."""

    turn: Array  # (3, 3)
    shift: Array  # (3,) m

    def of(self, points: Floats) -> Array:
        """Return (n, 3) m of (n, 3) m."""
        return np.asarray(points @ self.turn.T + self.shift)

    def back(self, points: Floats) -> Array:
        """Return (n, 3) m that `of` brings to (n, 3) m."""
        return np.asarray((points - self.shift) @ self.turn)


def onto(shape: Floats, target: Floats, *, one_way: bool = False) -> RigidMotion:
    """Return the motion that brings a shape (n, 3) m onto a target (k, 3) m. one_way: the target shows a part; its
    points alone are matched."""
    model = np.asarray(shape[:: max(1, len(shape) // SOME)], float)
    measured = np.asarray(target[:: max(1, len(target) // SOME)], float)
    tree = KDTree(measured)
    motion = RigidMotion(np.eye(3), np.zeros(3) if one_way else measured.mean(axis=0) - model.mean(axis=0))
    at = motion.of(model)
    for _ in range(ROUNDS):
        mine = KDTree(at).query(measured)[1]
        sources, goals = [model[mine]], [measured]
        if not one_way:
            sources.append(model)
            goals.append(measured[tree.query(at)[1]])
        motion = between(np.concatenate(sources), np.concatenate(goals))
        before, at = at, motion.of(model)
        if np.sqrt(np.square(at - before).sum(axis=1).mean()) < STILL:
            break
    return motion


def between(points: Array, goals: Array) -> RigidMotion:
    """Return the least-squares motion between pairs (n, 3) m."""
    middle, goal = points.mean(axis=0), goals.mean(axis=0)
    left, _, right = np.linalg.svd((points - middle).T @ (goals - goal))
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    turn = (left @ proper @ right).T
    return RigidMotion(turn, goal - turn @ middle)
