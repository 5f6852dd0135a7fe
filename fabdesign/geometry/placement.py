"""How a target's file lies in the world: unit, turn and shift, given or found on the hanging cloth. A few markers need
not show the edge, so that for them one-way distances decide. And the rigid motion between clouds, for a target that may
stand anywhere."""

import warnings
from dataclasses import dataclass
from itertools import permutations, product
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from fabdesign.geometry.hung_cloth import misplaced
from fabdesign.nouns.array import Array, Floats
from fabdesign.nouns.fabric import Fabric

Unit = Literal["m", "cm", "mm", "in"]
_Laid = tuple[float, Rotation, Array]  # how far off [m], turn and shift [m]

UNITS: dict[Unit, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}  # m
_STRIP = 0.2  # of the cloth's height, below the held edge: what is compared with the hanging cloth
_TOP = 0.5  # of the strip, where an edge's points are looked for
_COLUMNS = 20  # in which the edge is looked for
_STEADY = 1.0  # degrees: a smaller turn off the right angle is sampling, and is not made
# m, in the mean over the strip:
_GAIN = 0.006  # what exchanged axes must gain over the file's own
CLEAR = 0.004  # by how much a placement must fit better than one at another edge
TIE = 1e-4  # what a quarter turn must gain: between front and back the lesser turn decides
_ROUNDS = 4
_SOME = 500  # points by which shapes are compared
_ALIKE = 1e-3  # m, in the mean, beside the points' spacing, by which shapes that are one differ
OVER = Rotation.from_euler("y", 180, degrees=True)  # changes front and back
SAME = np.radians(20)  # turns that differ by less find the same edge
MARKERS = 200  # points; a cloud of fewer is markers: what lies between them is not measured
_ORIGIN_GAIN = 0.25  # of the markers' spacing, that another origin must gain over the file's own
_POINTS = 400  # of either cloud: the motion of a sheet is known from few
_TURNS = 60
_STILL = 1e-7  # m, RMS, by which a further round moves less is the last
_UPPER = 0.25  # of the markers, that show how deep the edge lies


@dataclass(frozen=True)
class Placement:
    """x [m] = R (factor * file) + translation, with R the turns about the fixed axes x, y, z in this order."""

    factor: float = 1.0  # m per unit of the file
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)  # degrees
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m

    def apply(self, points: Array) -> Array:
        """Return (n, 3) m of (n, 3) in the file's unit and frame."""
        turned = Rotation.from_euler("xyz", self.rotation, degrees=True).apply(self.factor * points)
        return np.asarray(turned + self.translation)

    @property
    def turn(self) -> str:
        """Return the rotation as a study file has it."""
        return "[" + ", ".join(f"{angle:g}" for angle in self.rotation) + "]"

    def __str__(self) -> str:
        shift = ", ".join(f"{x:g}" for x in self.translation)
        return f"rotation {self.turn} degrees, translation [{shift}] m"


@dataclass(frozen=True)
class PlacementFit:
    """A placement found, and what else could have been meant."""

    placement: Placement
    turned_over: Placement | None = None  # with front and back changed, where that fits as well
    rival: Placement | None = None  # at another edge, where that fits about as well


def fit_placement(
    points: Array,
    fabric: Fabric,
    *,
    factor: float = 1.0,
    rotation: tuple[float, float, float] | None = None,
    drawn: bool = True,
) -> PlacementFit:
    """Return the placement that brings an edge of points (n, 3), in the file's unit, onto the hung top edge, and the
    strip below it nearest to the hanging cloth.

    Without `rotation` [degrees] the 24 ways to exchange axes are tried, and the file's own are kept where they fit
    about as well. The edge is then laid straight by turns about y and z. There is no turn about the edge itself, by
    which a bent shape could be brought nearer to what the cloth can do.
    drawn: evenly on the surface, so that its edge lies a little beyond the points; else the edge's own are there.
    """
    given = Rotation.from_euler("xyz", rotation or np.zeros(3), degrees=True)
    metres = given.apply(factor * points)
    laid = [_on_edge(metres, turn, fabric, drawn) for turn in right_angles()[: 1 if rotation is not None else None]]
    fits = [(gap, turn * given, shift) for gap, turn, shift in laid]
    least, turn, shift = min(fits, key=lambda candidate: candidate[0])
    if fits[0][0] <= least + _GAIN:
        least, turn, shift = fits[0]
    placement = placement_of(factor, turn, shift)
    candidates = [(gap, other, placement_of(factor, other, s)) for gap, other, s in fits if gap < least + CLEAR]
    over = [p for gap, other, p in candidates if gap < least + 3 * TIE and differ(other, OVER * turn) < SAME]
    at = placement.apply(points)

    def opposite(other: Rotation) -> bool:  # of the cloth's edges is laid on the hung one
        return bool(abs((other * turn.inv()).as_matrix()[0, 0]) > np.cos(SAME))

    rivals = [
        p
        for _, other, p in candidates
        if min(differ(other, turn), differ(other, OVER * turn)) >= SAME
        and not (opposite(other) and _same_shape(p.apply(points), at))
    ]
    kept = turn is fits[0][1]
    return PlacementFit(placement, over[0] if over else None, rivals[0] if rivals and not kept else None)


def _same_shape(one: Array, other: Array) -> bool:
    """Return whether two placements (n, 3) m of a cloud show one shape, or one with front and back changed."""
    some, tree = one[:: max(1, len(one) // _SOME)], cKDTree(other)
    spacing = tree.query(other[:: max(1, len(other) // _SOME)], k=2)[0][:, 1].mean()
    gaps = [tree.query(shape)[0].mean() for shape in (some, some * [-1, 1, -1])]
    return bool(min(gaps) < spacing + _ALIKE)


def differ(a: Rotation, b: Rotation) -> float:
    return float((a * b.inv()).magnitude())


def placement_of(factor: float, turn: Rotation, shift: Array) -> Placement:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # at 90 degrees about y the angles are not unique
        angles = turn.as_euler("xyz", degrees=True)
    a, b, c = (round(float(angle), 4) + 0.0 for angle in angles)
    x, y, z = (round(float(value), 6) + 0.0 for value in shift)
    return Placement(factor, (a, b, c), (x, y, z))


def right_angles() -> list[Rotation]:
    """Return the 24 rotations that take axes to axes, least turn first."""
    frames = [
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order, signs in product(permutations(range(3)), product((1, -1), repeat=3))
    ]
    turns = [Rotation.from_matrix(frame) for frame in frames if np.linalg.det(frame) > 0]
    return sorted(turns, key=lambda turn: round(float(turn.magnitude()), 6))


def _on_edge(points: Array, turn: Rotation, fabric: Fabric, drawn: bool) -> _Laid:
    """Return points with their upper edge laid on the hung edge: the turn is made straight."""
    tie = TIE * turn.magnitude() / (np.pi / 2)
    for _ in range(_ROUNDS):
        turned = turn.apply(points)
        edge = _upper_edge(turned, fabric.height if drawn else 0.0)
        yaw, roll = (np.degrees(np.arctan(_slope(edge[:, 0], edge[:, k]))) for k in (2, 1))
        if max(abs(yaw), abs(roll)) < _STEADY:
            break
        turn = Rotation.from_euler("yz", [yaw, -roll], degrees=True) * turn
    top, depth = np.median(edge[:, 1]), np.median(edge[:, 2])
    beside = turned[turned[:, 1] > top - _TOP * _STRIP * fabric.height, 0]
    left, right = np.quantile(beside, [0.005, 0.995]) if drawn else (beside.min(), beside.max())
    shift = -np.array([(left + right) / 2, top, depth])
    return _strip_gap(turn.apply(points) + shift, fabric) + abs(float(right - left) - fabric.width) + tie, turn, shift


def _upper_edge(points: Array, height: float) -> Array:
    """Return (columns, 3): the uppermost point of each column across; the edge over as many points drawn evenly in a
    sheet of `height` [m] is a little higher."""
    low, high = np.quantile(points[:, 0], [0.01, 0.99])
    column = np.floor((points[:, 0] - low) / max(high - low, 1e-12) * _COLUMNS)
    tops = []
    for k in range(_COLUMNS):
        strip = points[column == k]
        if len(strip):
            highest = strip[np.argmax(strip[:, 1])]
            tops.append(highest + [0, height / (len(strip) + 1), 0])
    return np.array(tops)


def _slope(x: Array, y: Array) -> float:
    """Return the median of the slopes between all pairs (Theil and Sen), which strays do not move."""
    i, j = np.triu_indices(len(x), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i]))) if len(i) else 0.0


def _strip_gap(points: Array, fabric: Fabric) -> float:
    """Return the mean distance [m] of the hanging cloth's upper strip to the points, and of the points near the held
    edge to the strip, summed."""
    half, deep = fabric.width / 2, _STRIP * fabric.height
    x, y = np.meshgrid(np.linspace(-half, half, 41), np.linspace(0, -deep, 9))
    strip = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    edge = points[_off_cloth(points, fabric, 0.0) <= deep]
    if not len(edge):
        return np.inf
    return float(cKDTree(points).query(strip)[0].mean() + _off_cloth(edge, fabric, deep).mean())


def _off_cloth(points: Array, fabric: Fabric, deep: float) -> Array:
    """Return (n,) m from points to so much [m] of the cloth, from its hung edge down, as it hangs without pressure,
    flat."""
    half = fabric.width / 2
    x, y = points[:, 0].clip(-half, half), points[:, 1].clip(-deep, 0)
    return np.asarray(np.linalg.norm(points - np.stack([x, y, 0 * x], axis=1), axis=1))


def fit_markers(
    points: Array, fabric: Fabric, *, factor: float = 1.0, rotation: tuple[float, float, float] | None = None
) -> PlacementFit:
    """Return the placement of points (n, 3), in the file's unit, by the mean distance from them to the hanging cloth.

    rotation: degrees, where it is known; else the 24 ways to exchange axes are tried, the least turn first.
    """
    given = Rotation.from_euler("xyz", rotation or np.zeros(3), degrees=True)
    metres = given.apply(factor * points)
    sizes, laid = [], []
    for turn in right_angles()[: 1 if rotation is not None else None]:
        turned = turn.apply(metres)
        tie = TIE * float(turn.magnitude()) / (np.pi / 2)
        if misplaced(turned, fabric) is None:
            sizes.append((float(_off_cloth(turned, fabric, fabric.height).mean()) + tie, turn * given, np.zeros(3)))
        # the markers' middle below the edge's, the uppermost as far below it as spread evenly
        upper = turned[turned[:, 1] >= np.quantile(turned[:, 1], 1 - _UPPER)]
        across = (turned[:, 0].min() + turned[:, 0].max()) / 2
        top = turned[:, 1].max() + fabric.height / (len(turned) + 1)
        shift = -np.array([across, top, np.median(upper[:, 2])])
        laid.append((float(_off_cloth(turned + shift, fabric, fabric.height).mean()) + tie, turn * given, shift))
    spacing = float(np.sqrt(fabric.width * fabric.height / len(points)))
    best = min(gap for gap, _, _ in laid)
    sound = [candidate for candidate in sizes if candidate[0] <= best + _ORIGIN_GAIN * spacing] or laid
    least, turn, shift = min(sound, key=lambda candidate: candidate[0])
    candidates = [(gap, other, placement_of(factor, other, s)) for gap, other, s in sound if gap < least + CLEAR]
    over = [p for _, other, p in candidates if differ(other, OVER * turn) < SAME]
    rivals = [p for _, other, p in candidates if min(differ(other, turn), differ(other, OVER * turn)) >= SAME]
    return PlacementFit(placement_of(factor, turn, shift), over[0] if over else None, rivals[0] if rivals else None)


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
    points alone are matched.

    Iterated closest points (Besl and McKay, A method for registration of 3-D shapes, IEEE PAMI 14, 1992), each point
    matched with the nearest of the other cloud. It begins where the target was placed, with both centres on each other,
    so that a shape has one answer; a turn of more than some 60 degrees from there it may not find.
    """
    model = np.asarray(shape[:: max(1, len(shape) // _POINTS)], float)
    measured = np.asarray(target[:: max(1, len(target) // _POINTS)], float)
    tree = cKDTree(measured)
    motion = RigidMotion(np.eye(3), np.zeros(3) if one_way else measured.mean(axis=0) - model.mean(axis=0))
    at = motion.of(model)
    for _ in range(_TURNS):
        mine = cKDTree(at).query(measured)[1]
        sources, goals = [model[mine]], [measured]
        if not one_way:
            sources.append(model)
            goals.append(measured[tree.query(at)[1]])
        motion = between(np.concatenate(sources), np.concatenate(goals))
        before, at = at, motion.of(model)
        if np.sqrt(np.square(at - before).sum(axis=1).mean()) < _STILL:
            break
    return motion


def between(points: Array, goals: Array) -> RigidMotion:
    """Return the least-squares motion between pairs (n, 3) m, by singular values (Kabsch 1976)."""
    middle, goal = points.mean(axis=0), goals.mean(axis=0)
    left, _, right = np.linalg.svd((points - middle).T @ (goals - goal))
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    turn = (left @ proper @ right).T
    return RigidMotion(turn, goal - turn @ middle)
