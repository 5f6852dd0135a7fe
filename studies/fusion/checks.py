"""What goes wrong at a rig, found in the clouds themselves: swapped sensors, clocks that differ."""

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from studies.fusion.joint import SensorView, gaps

Array = NDArray[np.float64]
DISAGREE = 0.003  # m, median distance between sensors that is no noise
BETTER = 0.5  # what a swap or another frame must leave of it
LEAST_OVERLAP = 60  # points
MOVED = 0.0025  # m: a camera so far from every other one was moved


def disagreement(views: Sequence[SensorView], poses: Sequence[Array], sides: Sequence[str], thickness: float) -> float:
    """Median distance [m] between the sensors of one frame; points without a partner count as far."""
    gaps = [_gap(a, b, poses, sides, thickness) for a, b in combinations(views, 2)]
    return float(np.median(gaps)) if gaps else 0.0


def swapped_pair(
    views: Sequence[SensorView], poses: Sequence[Array], sides: Sequence[str], thickness: float
) -> tuple[int, int] | None:
    """The front and back cameras whose clouds must be exchanged for the frame to agree, if that is what is wrong."""
    now = disagreement(views, poses, sides, thickness)
    best: tuple[float, tuple[int, int]] | None = None
    for a, b in combinations([v.camera for v in views], 2):
        if sides[a] == sides[b]:
            continue
        other = {a: b, b: a}
        exchanged = [SensorView(v.frame, other.get(v.camera, v.camera), v.cloud) for v in views]
        then = disagreement(exchanged, poses, sides, thickness)
        if then < BETTER * now and (best is None or then < best[0]):
            best = then, (a, b)
    return None if best is None else best[1]


def late_sensor(
    views: Sequence[SensorView], poses: Sequence[Array], sides: Sequence[str], thickness: float
) -> tuple[int, int] | None:
    """The camera whose frames fit the others' so many frames later (or earlier), if one does."""
    cameras = sorted({v.camera for v in views})
    by_place = {(v.frame, v.camera): v for v in views if v.frame >= 0}
    best: tuple[float, tuple[int, int]] | None = None
    for camera in cameras:
        cost = {}
        for lag in (-2, -1, 0, 1, 2):
            late = [
                _gap(view, by_place[frame + lag, other], poses, sides, thickness)
                for (frame, mine), view in by_place.items()
                if mine == camera
                for other in cameras
                if other != camera and (frame + lag, other) in by_place
            ]
            cost[lag] = float(np.mean(late)) if late else np.inf
        lag = min(cost, key=lambda k: cost[k])
        gain = cost[lag] / cost[0] if cost[0] > 0 else 1.0
        if lag and gain < BETTER and (best is None or gain < best[0]):
            best = gain, (camera, lag)
    return None if best is None else best[1]


def moved_camera(
    views_at: Callable[[int], Sequence[SensorView]],
    frames: int,
    poses: Sequence[Array],
    sides: Sequence[str],
    thickness: float,
) -> tuple[int, int] | None:
    """The camera whose views leave those of all others from a frame on, to the end, and that frame."""
    last = next((k for k in range(frames - 1, max(frames - 6, -1), -1) if len(views_at(k)) == len(poses)), None)
    if last is None or len(poses) < 3:
        return None

    def alone(frame: int) -> dict[int, float]:
        """By camera the least of its distances to the others."""
        views = views_at(frame)
        least = dict.fromkeys(range(len(poses)), np.inf)
        for a, b in combinations(views, 2):
            gap = _gap(a, b, poses, sides, thickness)
            for view in (a, b):
                least[view.camera] = min(least[view.camera], gap)
        return least

    at_end = alone(last)
    far = [camera for camera, gap in at_end.items() if MOVED < gap < np.inf]
    if len(far) != 1 or max(gap for camera, gap in at_end.items() if camera != far[0]) > MOVED:
        return None
    sound, moved = -1, last
    while moved - sound > 1:
        middle = (sound + moved) // 2
        sound, moved = (sound, middle) if alone(middle)[far[0]] > MOVED else (middle, moved)
    return far[0], moved


def _gap(one: SensorView, other: SensorView, poses: Sequence[Array], sides: Sequence[str], thickness: float) -> float:
    distance = gaps(one, other, poses, sides, thickness).distance
    return float(np.median(np.abs(distance))) if len(distance) >= LEAST_OVERLAP else 2 * DISAGREE
