"""Poses of cameras to each other from a target that they all see: the middle of a sphere, or the corners of a ChArUco
board (the package cv2, extra `board`). The world's frame stays that of the nominal poses as a whole."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fabdesign.clouds.recording import Recording
from fabdesign.depth.sensor import SeenTarget, depth_stream
from fabdesign.depth.stream import DepthStream, paired_as_stamped
from fabdesign.errors import InputError
from fabdesign.geometry.placement import between
from fabdesign.nouns.array import Array

Seen = Mapping[tuple[int, int], Array]  # (frame, corner) -> (3,) m in the camera's frame
OFF_SPHERE = 0.004  # m from the surface that counts as on it
LEAST_ON_SPHERE = 0.1  # of the pixels that a whole sphere there would have
TRIES, SAMPLE, PLENTY = 200, 800, 0.7  # PLENTY: of a whole sphere's pixels, with which no more is tried
MOST_IMAGES = 120  # of each camera
LEAST_COMMON = 3
OFF_LINE = 0.01  # m, root mean square of places beside their best line
STILL = 0.002  # m: a target that moves more between images is left out
ROUNDS = 200
FAR = 1.5  # m from the camera


def with_target_poses(recording: Recording) -> tuple[Recording, dict[str, float]]:
    """Return the recording with the poses that its target says, and each sensor's residual [m]. Raises InputError."""
    target = recording.target
    if target is None:
        return recording, {}
    place = recording.folder / target.folder
    shown = [depth_stream(sensor, place, None) for sensor in recording.sensors]
    streams = [stream for stream in shown if stream is not None]
    if len(streams) != len(shown):
        raise InputError(f"{place}: a target is seen in depth images; expected bag or images of each sensor")
    paired, chosen = paired_as_stamped(streams, 30.0, str(place))
    chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, MOST_IMAGES).round().astype(int))]
    points = [target_points(stream, [int(k) for k in chosen[:, c]], target) for c, stream in enumerate(paired)]
    seen = [{key: point for key, point in each.items() if not _moves(each, *key)} for each in points]
    nominal = [sensor.camera_to_world for sensor in recording.sensors]
    poses, residuals = solve(seen, nominal, [sensor.name for sensor in recording.sensors])
    sensors = tuple(replace(s, camera_to_world=pose) for s, pose in zip(recording.sensors, poses, strict=True))
    return replace(recording, sensors=sensors), {s.name: r for s, r in zip(sensors, residuals, strict=True)}


def upright(recording: Recording) -> Recording:
    """Return the recording with its poses turned as one about the middle of the top edge, so that gravity, as the
    accelerometers feel it on average, is the world's -y; as it is where no camera has one."""
    down = felt_gravity(recording.depth, [sensor.camera_to_world for sensor in recording.sensors])
    if down is None:
        return recording
    turn = np.eye(4)
    turn[:3, :3] = Rotation.align_vectors([[0.0, -1.0, 0.0]], [down])[0].as_matrix()
    sensors = tuple(replace(s, camera_to_world=turn @ s.camera_to_world) for s in recording.sensors)
    return replace(recording, sensors=sensors)


def felt_gravity(streams: Sequence[DepthStream], poses: Sequence[Array]) -> Array | None:
    """Return the direction (3,) of gravity in the world by the cameras that feel it; None where none does."""
    felt = [pose[:3, :3] @ s.gravity for s, pose in zip(streams, poses, strict=True) if s.gravity is not None]
    return None if not felt else np.asarray(np.sum(felt, axis=0) / np.linalg.norm(np.sum(felt, axis=0)))


def solve(seen: Sequence[Seen], nominal: Sequence[Array], names: Sequence[str]) -> tuple[list[Array], list[float]]:
    """Return the poses (4, 4) that place common points best on each other, and each one's residual [m].

    Raises InputError for a camera with too few points in common, or along a line.
    """
    counts = Counter(chain.from_iterable(seen))
    common = [[key for key in places if counts[key] > 1] for places in seen]
    for name, keys, places in zip(names, common, seen, strict=True):
        points = np.array([places[key] for key in keys]).reshape(-1, 3)
        several = len(keys) >= LEAST_COMMON
        if not several or np.linalg.svd(points - points.mean(axis=0))[1][1] < OFF_LINE * len(keys) ** 0.5:
            raise InputError(
                f"target: sensor {name} has {len(keys)} places in common with others"
                f"{', on a line' * several}; expected {LEAST_COMMON} and more, not on a line"
            )
    poses = [pose.copy() for pose in nominal]
    for _ in range(ROUNDS):
        placed: dict[tuple[int, int], list[Array]] = {}
        for pose, keys, places in zip(poses, common, seen, strict=True):
            for key in keys:
                placed.setdefault(key, []).append(pose[:3, :3] @ places[key] + pose[:3, 3])
        middle = {key: np.mean(points, axis=0) for key, points in placed.items()}
        poses = [
            _rigid(np.array([places[key] for key in keys]), np.array([middle[key] for key in keys]))
            for keys, places in zip(common, seen, strict=True)
        ]
    marks = [  # points [m] that go with the cameras: their places and 0.6 m along their axes
        np.concatenate([[p[:3, 3], *(p[:3, 3] + 0.6 * p[:3, k] for k in range(3))] for p in each])
        for each in (poses, nominal)
    ]
    back = _rigid(*marks)
    residuals = [
        float(np.sqrt(np.mean([((pose[:3, :3] @ places[k] + pose[:3, 3] - middle[k]) ** 2).sum() for k in keys])))
        for pose, keys, places in zip(poses, common, seen, strict=True)
    ]
    return [back @ pose for pose in poses], residuals


def _rigid(points: Array, onto: Array) -> Array:
    """Return the turn and shift (4, 4) that lays points (n, 3) on others best."""
    motion, pose = between(points, onto), np.eye(4)
    pose[:3, :3], pose[:3, 3] = motion.turn, motion.shift
    return pose


def target_points(stream: DepthStream, numbers: Sequence[int], target: SeenTarget) -> dict[tuple[int, int], Array]:
    """Return the target's points in a camera's frame, by frame and corner."""
    seen: dict[tuple[int, int], Array] = {}
    rng = np.random.default_rng(0)
    for frame, number in enumerate(numbers):
        if target.sphere is not None:
            middle = sphere_middle(stream.cloud(number), target.sphere, 1 / stream.camera.focal[0], rng)
            seen |= {} if middle is None else {(frame, 0): middle}
        else:
            seen |= {(frame, corner): point for corner, point in _board(stream, number, target).items()}
    return seen


def _moves(seen: Seen, frame: int, corner: int) -> bool:
    """Return whether a point of the target is elsewhere in the frame before or after."""
    beside = [seen.get((frame + step, corner)) for step in (-1, 1)]
    return any(other is not None and np.linalg.norm(other - seen[frame, corner]) > STILL for other in beside)


def sphere_middle(cloud: Array, radius: float, pixel: float, rng: np.random.Generator) -> Array | None:
    """Return the middle [m] of a sphere in a cloud (n, 3) m, by random triples (RANSAC) and least squares, or None.

    pixel: slope between pixels.
    """
    cloud = cloud[cloud[:, 2] < FAR]
    if len(cloud) < 100:
        return None
    best: tuple[int, Array] | None = None
    sample = cloud[rng.choice(len(cloud), min(SAMPLE, len(cloud)), replace=False)]
    for _ in range(TRIES):
        first = sample[rng.integers(len(sample))]
        beside = sample[np.linalg.norm(sample - first, axis=1) < 1.6 * radius]
        if len(beside) < 10:
            continue
        second, third = beside[rng.choice(len(beside), 2, replace=False)]
        middle = _through(first, second, third, radius)
        if middle is not None:
            count = int((np.abs(np.linalg.norm(sample - middle, axis=1) - radius) < OFF_SPHERE).sum())
            if best is None or count > best[0]:
                best = count, middle
                if count > PLENTY * np.pi * (radius / middle[2] / pixel) ** 2 * len(sample) / len(cloud):
                    break
    if best is None:
        return None
    middle = best[1]
    for _ in range(8):
        off = cloud - middle
        distance = np.linalg.norm(off, axis=1)
        on = np.abs(distance - radius) < OFF_SPHERE
        if on.sum() < 30:
            return None
        ray = off[on] / distance[on, None]
        middle = middle + np.linalg.lstsq(ray, distance[on] - radius, rcond=None)[0]
    expected = np.pi * (radius / middle[2] / pixel) ** 2
    return middle if on.sum() > LEAST_ON_SPHERE * expected else None


def _through(a: Array, b: Array, c: Array, radius: float) -> Array | None:
    """Return the middle, away from the camera, of the sphere of a radius through three points."""
    ab, ac = b - a, c - a
    normal = np.cross(ab, ac)
    size = float(normal @ normal)
    if size < 1e-14:
        return None
    circle = (np.cross(normal, ab) * (ac @ ac) + np.cross(ac, normal) * (ab @ ab)) / (2 * size)
    height = radius**2 - float(circle @ circle)
    if height <= 0:
        return None
    normal = normal * np.sign(normal @ a) / size**0.5
    return np.asarray(a + circle + normal * height**0.5)


def _board(stream: DepthStream, number: int, target: SeenTarget) -> dict[int, Array]:
    """Return the corners of a ChArUco board [m] in the camera's frame, by their number. Raises InputError."""
    try:
        import cv2
    except ImportError:
        raise InputError("a ChArUco board needs the package cv2; pip install fabdesign[board]") from None
    if stream.colour is None or stream.colour_camera is None:
        raise InputError(f"{stream.where}: no colour images; expected some, to see a board")
    aruco: Any = cv2.aruco
    if not hasattr(aruco, target.dictionary):
        raise InputError(f"target: dictionary {target.dictionary[:40]!r}; expected a name of OpenCV, as DICT_4X4_50")
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, target.dictionary))
    board = aruco.CharucoBoard(target.size, target.square, target.marker, dictionary)
    corners, numbers, _, _ = aruco.CharucoDetector(board).detectBoard(stream.colour(number))
    if numbers is None or len(numbers) < 6:
        return {}
    ids = numbers.ravel()
    flat = stream.colour_camera.slopes_of(corners.reshape(-1, 2).astype(np.float64))
    places = board.getChessboardCorners()[ids]
    solved, turn, shift = cv2.solvePnP(places, flat, np.eye(3), None)
    if not solved:
        return {}
    world = places @ cv2.Rodrigues(turn)[0].T + shift.ravel()
    return {int(k): np.asarray(point, dtype=np.float64) for k, point in zip(ids, world, strict=True)}
