"""How far a batch of designs comes from the target: forward model in, one number a design out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial import KDTree

from fabdesign.geometry.metrics import Errors, chamfer_to, distance_to_faces, shares_at, surface_rms
from fabdesign.geometry.placement import RigidMotion, onto
from fabdesign.geometry.shape import Face, Shape
from fabdesign.geometry.surface import CAP, Surface, capped_rms, half_of
from fabdesign.geometry.wishes import Landmarks, Weighting
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import SIDE, Case, ForwardModel
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.study_files.study_file import MeasureName

Poses = Array  # (poses, 2 n, 3) m: one design under each pose's pressures
# m, of distances and their shares; and its slope by each
Norm = Callable[[Array, Array], tuple[float, Array]]
LATE = 1.0  # s after rest, from which on a motion's frame is taken to be near the shape at rest
THIN = 2  # a step is chosen on every second point of target and model: cheaper, the same step
SURFACE_THIN = 6  # the same for surface RMS, of the target alone: triangles cost more, and blur less, than points


@dataclass(frozen=True, eq=False)
class Target:
    """A cloud to come close to: the motion at `time` [s] under constant pressures, or the equilibrium (None)."""

    points: Array  # (n, 3) m
    time: float | None = None
    markers: bool = False  # few points, or a part: in place of Chamfer, their mean distance to the cloth's faces
    face: Face = "both"  # that the points lie on
    landmarks: Landmarks | None = None  # in place of the points: their mean distance
    free: bool = False  # it may stand anywhere: distances are of the shape moved onto it
    weighting: Weighting | None = None  # how much each place of the cloth counts

    def motion(self, pose: Array) -> RigidMotion:
        """Return the motion that brings a shape (2 n, 3) m onto it where it is free."""
        return onto(half_of(pose, self.face), self.points, one_way=self.markers)


@dataclass(frozen=True, eq=False)
class Objective:
    """Mean over the poses' targets of one of MEASURES [m].

    order: the place in the specimen's session of what is searched for, 0 of a rested one. weights: of the targets in
    the mean, above 0; empty: all alike.
    """

    targets: Sequence[Target]
    measure: MeasureName = "chamfer"
    order: int = 0
    weights: Sequence[float] = ()

    @property
    def at_rest(self) -> "Objective":
        """Return the same of shapes at rest in place of late frames: they are near them, and cost a quarter."""
        late = [t if t.time is None or t.time < LATE else replace(t, time=None) for t in self.targets]
        return replace(self, targets=late)

    @property
    def shares(self) -> Array:
        """Return (poses,) of the targets in the mean; they sum to 1."""
        weights = np.array(self.weights or [1.0] * len(self.targets))
        return np.asarray(weights / weights.sum())

    def shapes(
        self, forward: ForwardModel, layouts: Sequence[tuple[Design, Array]], models: Sequence[Predictor] = ()
    ) -> list[Poses]:
        """Return the shape of each design under its (poses, channels) pressures [Pa]; a diverged one holds NaN. models:
        of which each design's cases carry what its own adds."""
        shapes: list[list[Poses]] = [[] for _ in layouts]
        for pose, target in enumerate(self.targets):
            cases = self.cases(pose, layouts)
            if models:
                cases = [model.case(case) for model, case in zip(models, cases, strict=True)]
            if target.time is None:
                clouds = forward.equilibria(cases)
            else:
                clouds = [motion[-1] for motion in forward.motions(cases, [np.array([target.time])] * len(cases))]
            for shape, cloud in zip(shapes, clouds, strict=True):
                shape.append(refined(np.asarray(cloud, np.float64)))
        return [np.array(shape) for shape in shapes]

    def cases(self, pose: int, layouts: Sequence[tuple[Design, Array]]) -> list[Case]:
        """Return the cases of designs, each with its (poses, channels) pressures [Pa], in one pose."""
        duration = self.targets[pose].time or 0.0
        return [
            Case(design, PressureProgram(np.zeros(1), pressures[pose][None], duration), order=self.order)
            for design, pressures in layouts
        ]

    def value(self, shape: Poses) -> float:
        """Return m; NaN where the shape is not finite."""
        if not np.all(np.isfinite(shape)):
            return float("nan")
        return float(self.shares @ [self._distance(t, pose) for t, pose in zip(self.targets, shape, strict=True)])

    def values(self, shapes: Sequence[Poses]) -> list[float]:
        """Return m of each; infinite where it is not finite."""
        return [value if np.isfinite(value := self.value(shape)) else np.inf for shape in shapes]

    def nearest(self, shapes: Sequence[Poses]) -> list[tuple[int, int]]:
        """Return for each target which of the shapes, and which pose of it, comes nearest to it, of those computed for
        its instant; its own pose of the first where none is finite."""
        chosen = []
        for number, target in enumerate(self.targets):
            places = [(k, pose) for k in range(len(shapes)) for pose in range(len(self.targets))]
            places = [(k, pose) for k, pose in places if self.targets[pose].time == target.time]
            finite = [(k, pose) for k, pose in places if np.all(np.isfinite(shapes[k][pose]))]
            distance = {place: self._distance(target, shapes[place[0]][place[1]]) for place in finite}
            chosen.append(min(finite, key=distance.__getitem__, default=(0, number)))
        return chosen

    def _distance(self, target: Target, pose: Array) -> float:
        if target.landmarks is not None:
            return target.landmarks.mean(pose)
        if target.free:
            pose = target.motion(pose).of(pose)
        return MEASURES[self.measure].value(target, pose)

    @property
    def thin(self) -> int:
        """Return the stride through a shape's points that `gradient` can do with."""
        every_point = any(t.markers or t.landmarks is not None or t.weighting is not None for t in self.targets)
        return 1 if every_point else MEASURES[self.measure].thin

    def gradient(self, shape: Poses) -> tuple[float, Poses]:
        """Return the value [m] against the thinned targets, and its derivative by each coordinate (nearest neighbours
        held)."""
        gradients = [self._gradient(t, pose) for t, pose in zip(self.targets, shape, strict=True)]
        slopes = np.array([slope for _, slope in gradients])
        return float(self.shares @ [value for value, _ in gradients]), self.shares[:, None, None] * slopes

    def _gradient(self, target: Target, pose: Array) -> tuple[float, Array]:
        if target.landmarks is not None:
            return target.landmarks.gradient(pose)
        if target.free:  # at its minimum the motion itself has no slope
            motion = target.motion(pose)
            value, slope = MEASURES[self.measure].gradient(target, motion.of(pose))
            return value, slope @ motion.turn
        return MEASURES[self.measure].gradient(target, pose)


@dataclass(frozen=True)
class Measure:
    """A way to say how far a pose (2 n, 3) m lies from a target where it stands.

    value: m. gradient: m against the thinned target, and its derivative by each coordinate (2 n, 3), nearest neighbours
    held. errors: which of a result's errors it is, and that one's noise floor. thin: the stride through a pose's points
    that `gradient` can do with.
    """

    name: str  # for people
    value: Callable[[Target, Array], float]
    gradient: Callable[[Target, Array], tuple[float, Array]]
    errors: Callable[[Errors], tuple[float, float]]
    thin: int = 1


def _chamfer(target: Target, pose: Array) -> float:
    """Return the Chamfer distance, unsquared, both directions summed; of markers the mean one to the cloth."""
    if target.markers:
        return distance_to_faces(target.points, pose, target.face, target.weighting)
    return chamfer_to(pose, target.face, target.weighting).of(target.points)


def _chamfer_gradient(target: Target, pose: Array) -> tuple[float, Array]:
    if target.markers:
        return _faces_gradient(target.points, pose, target, _mean)
    return _points_gradient(_tree(target), pose, target.face, target.weighting)


MEASURES: Mapping[MeasureName, Measure] = {
    "chamfer": Measure(
        "Chamfer distance", _chamfer, _chamfer_gradient, lambda errors: (errors.chamfer, errors.chamfer_floor), THIN
    ),
    "surface_rms": Measure(
        "surface RMS",
        lambda target, pose: surface_rms(target.points, pose, target.face, target.weighting),
        lambda target, pose: _faces_gradient(target.points[::SURFACE_THIN], pose, target, _capped_rms),
        lambda errors: (errors.surface_rms, errors.surface_floor),
    ),
}


@lru_cache(maxsize=64)
def _tree(target: Target) -> KDTree:
    return KDTree(target.points[::THIN])


def _points_gradient(target: KDTree, every: Array, face: Face, weighting: Weighting | None) -> tuple[float, Array]:
    measured, model = np.asarray(target.data), half_of(every, face)
    weights = np.ones(len(model)) if weighting is None else half_of(weighting.of_points(len(every)), face)
    to_target, nearest_target = target.query(model)
    to_model, nearest_model = KDTree(model, balanced_tree=False).query(measured)
    shares, at_nearest = weights / weights.sum(), weights[nearest_model] / weights[nearest_model].sum()
    slope = (model - measured[nearest_target]) * (shares / np.maximum(to_target, 1e-12))[:, None]
    pull = (model[nearest_model] - measured) * (at_nearest / np.maximum(to_model, 1e-12))[:, None]
    for axis in range(3):
        slope[:, axis] += np.bincount(nearest_model, pull[:, axis], len(model))
    slopes = np.zeros_like(every)
    half_of(slopes, face)[:] = slope
    return float(shares @ to_target + at_nearest @ to_model), slopes


def _faces_gradient(measured: Array, model: Array, target: Target, norm: Norm) -> tuple[float, Array]:
    """Return value and slopes of a norm of the distances of measured points to the faces."""
    surface = Surface.of_faces(model, face=target.face)
    nearest = surface.nearest(measured)
    value, slope = norm(nearest.distance, shares_at(surface, nearest, target.weighting))
    corners = surface.triangles[nearest.triangle]  # (n, 3)
    away = np.einsum("nk,nkd->nd", nearest.weights, model[corners]) - measured
    pull = (slope / np.maximum(nearest.distance, 1e-12))[:, None] * away
    on_corners = (nearest.weights[:, :, None] * pull[:, None, :]).reshape(-1, 3)
    columns = [np.bincount(corners.ravel(), on_corners[:, axis], len(model)) for axis in range(3)]
    return value, np.stack(columns, axis=1)


def _capped_rms(distance: Array, shares: Array) -> tuple[float, Array]:
    value = capped_rms(distance, shares=shares)
    within = np.where(distance < CAP, distance, 0.0)  # strays beyond it have no slope
    return value, shares * within / max(value, 1e-12)


def _mean(distance: Array, shares: Array) -> tuple[float, Array]:
    return float(shares @ distance), shares


def refined(cloud: Array) -> Array:
    """Return (2 SIDE^2, 3) m, of both faces' points on a coarser grid too."""
    shape = Shape.of(cloud)
    if shape.side >= SIDE:
        return cloud
    weights = _spline_weights(shape.side)
    faces = np.einsum("ai,bj,fijc->fabc", weights, weights, shape.faces, optimize=True)
    return faces.reshape(-1, 3)


@lru_cache(maxsize=8)
def _spline_weights(side: int) -> Array:
    """Return (SIDE, side) cubic interpolation from `side` even nodes."""
    nodes, dense = np.linspace(0, 1, side), np.linspace(0, 1, SIDE)
    return np.asarray(make_interp_spline(nodes, np.eye(side), k=3)(dense))
