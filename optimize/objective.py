"""How far a batch of designs comes from the target: forward model in, one number a design out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.spatial import KDTree

from fabdesign.distances import chamfer
from fabdesign.forward import Case, ForwardModel
from fabdesign.pressure import PressureProgram
from optimize.design_space import DesignSpace, Vector

Shape = NDArray[np.float64]  # (poses, 2 n, 3) m: one design under each pose's pressures
THIN = 2  # a step is chosen on every second point of target and model: a quarter of the cost, the same step
POINTS_PER_SIDE = 41  # a coarser forward model's faces are interpolated to this many before they are compared


@dataclass(frozen=True, eq=False)
class Target:
    """A cloud to come close to: the motion at `time` [s] under constant pressures, or the equilibrium (None)."""

    points: NDArray[np.float64]  # (n, 3) m
    time: float | None = None


@dataclass(frozen=True, eq=False)
class Objective:
    """Mean over the poses' targets of the Chamfer distance [m]: unsquared, both directions summed.

    `factors` multiply declared values (fabdesign.forward.PARAMETERS), as a calibrated model has them.
    """

    targets: Sequence[Target]
    factors: Mapping[str, float] = field(default_factory=dict)

    def shapes(self, forward: ForwardModel, points: Sequence[tuple[DesignSpace, Vector]]) -> list[Shape]:
        """The shape of each point; a diverged one holds NaN."""
        decoded = [space.decode(x) for space, x in points]
        shapes: list[list[Shape]] = [[] for _ in points]
        for pose, target in enumerate(self.targets):
            duration = target.time or 0.0
            cases = [
                Case(design, PressureProgram(np.zeros(1), pressures[pose][None], duration), self.factors)
                for design, pressures in decoded
            ]
            if target.time is None:
                clouds = forward.equilibria(cases)
            else:
                clouds = [motion[-1] for motion in forward.motions(cases, [np.array([target.time])] * len(cases))]
            for shape, cloud in zip(shapes, clouds, strict=True):
                shape.append(_refined(np.asarray(cloud, np.float64)))
        return [np.array(shape) for shape in shapes]

    def value(self, shape: Shape) -> float:
        """m; NaN where the shape is not finite."""
        if not np.all(np.isfinite(shape)):
            return float("nan")
        return float(np.mean([chamfer(t.points, pose) for t, pose in zip(self.targets, shape, strict=True)]))

    def gradient(self, shape: Shape) -> tuple[float, Shape]:
        """Value [m] against every THIN-th target point, and its derivative by each coordinate (neighbours held)."""
        values, slopes = zip(
            *(_chamfer_gradient(t, pose) for t, pose in zip(self._trees, shape, strict=True)), strict=True
        )
        return float(np.mean(values)), np.array(slopes) / len(values)

    @property
    def _trees(self) -> list[KDTree]:
        return [_tree(t) for t in self.targets]


@lru_cache(maxsize=64)
def _tree(target: Target) -> KDTree:
    return KDTree(target.points[::THIN])


def _chamfer_gradient(target: KDTree, model: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    measured = np.asarray(target.data)
    to_target, nearest_target = target.query(model)
    to_model, nearest_model = KDTree(model, balanced_tree=False).query(measured)
    slope = (model - measured[nearest_target]) / (np.maximum(to_target, 1e-12) * len(model))[:, None]
    pull = (model[nearest_model] - measured) / (np.maximum(to_model, 1e-12) * len(measured))[:, None]
    for axis in range(3):
        slope[:, axis] += np.bincount(nearest_model, pull[:, axis], len(model))
    return float(to_target.mean() + to_model.mean()), slope


def _refined(cloud: NDArray[np.float64]) -> NDArray[np.float64]:
    side = round(np.sqrt(len(cloud) / 2))
    if side >= POINTS_PER_SIDE or not np.all(np.isfinite(cloud)):
        return cloud
    weights = _spline_weights(side)
    faces = np.einsum("ai,bj,fijc->fabc", weights, weights, cloud.reshape(2, side, side, 3), optimize=True)
    return faces.reshape(-1, 3)


@lru_cache(maxsize=8)
def _spline_weights(side: int) -> NDArray[np.float64]:
    """(41, side) cubic interpolation from `side` even nodes."""
    nodes, dense = np.linspace(0, 1, side), np.linspace(0, 1, POINTS_PER_SIDE)
    return np.asarray(make_interp_spline(nodes, np.eye(side), k=3)(dense))
