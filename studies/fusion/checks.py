"""This module finds errors of a rig in the clouds themselves: swapped sensors, clocks that differ."""

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from fabdesign.nouns.array import Array
from studies.fusion.joint import SensorView, gaps

DISAGREE = 0.003  # m, median distance between sensors that is no noise
BETTER = 0.5  # what a swap or another frame must leave of it
LEAST_OVERLAP = 60  # points
LAGS = (-2, -1, 0, 1, 2)  # frames
CHANGE = 0.001  # m: what a change of the lag by one must save in distances, summed over frames
UNKNOWN = 0.0005  # m: a frame without partners
MOVED = 0.0025  # m: a camera so far from every other one was moved


def disagreement(views: Sequence[SensorView], poses: Sequence[Array], sides: Sequence[str], thickness: float) -> float:
    """Median distance [m] between the sensors of one frame; points without a partner count as far."""
    gaps = [_gap(a, b, poses, sides, thickness) for a, b in combinations(views, 2)]
    return float(np.median(gaps)) if gaps else 0.0


def swapped_pair(
    views: Sequence[SensorView], poses: Sequence[Array], sides: Sequence[str], thickness: float
) -> tuple[int, int] | None:
    """Return the front and back cameras whose clouds must be exchanged for the frame to agree, if that is wrong."""
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


def shifted_sensor(
    views: Sequence[SensorView], poses: Sequence[Array], sides: Sequence[str], thickness: float
) -> tuple[int, dict[int, int]] | None:
    """Return the camera whose frames fit the others' some frames later (or earlier), by frame how many, if one does.

    Where no stamps are there, the motion itself tells of a cloud that was lost or stands twice: from then on a camera's
    frames fit others. The path of lags with the least distances is taken; a change of the lag costs CHANGE.
    """
    cameras = sorted({v.camera for v in views})
    by_place = {(v.frame, v.camera): v for v in views if v.frame >= 0}
    frames = sorted({frame for frame, _ in by_place})
    best: tuple[float, tuple[int, dict[int, int]]] | None = None
    for camera in cameras:
        cost = np.full((len(frames), len(LAGS)), UNKNOWN)
        for i, frame in enumerate(frames):
            for j, lag in enumerate(LAGS):
                others = [by_place.get((frame + lag, other)) for other in cameras if other != camera]
                view = by_place.get((frame, camera))
                gaps = [_gap(view, other, poses, sides, thickness) for other in others if view and other]
                cost[i, j] = float(np.mean(gaps)) if gaps else UNKNOWN
        path = _cheapest(cost)
        zero = LAGS.index(0)
        before = float(cost[:, zero].mean())
        gain = float(np.mean([cost[i, j] for i, j in enumerate(path)])) / before if before > 0 else 1.0
        if any(j != zero for j in path) and gain < BETTER and (best is None or gain < best[0]):
            best = gain, (camera, {frame: LAGS[j] for frame, j in zip(frames, path, strict=True)})
    return None if best is None else best[1]


def _cheapest(cost: Array) -> list[int]:
    """Return the column of each row with the least sum, where each change of the column costs CHANGE (Viterbi)."""
    total, came = cost[0].copy(), []
    change = CHANGE * np.abs(np.subtract.outer(np.arange(cost.shape[1]), np.arange(cost.shape[1])))
    for row in cost[1:]:
        through = total[:, None] + change
        came.append(through.argmin(axis=0))
        total = through.min(axis=0) + row
    path = [int(total.argmin())]
    for back in reversed(came):
        path.append(int(back[path[-1]]))
    return path[::-1]


def moved_camera(
    views_at: Callable[[int], Sequence[SensorView]],
    frames: int,
    poses: Sequence[Array],
    sides: Sequence[str],
    thickness: float,
) -> tuple[int, int] | None:
    """Return the camera whose views leave those of all others from a frame on, to the end, and that frame."""
    last = next((k for k in range(frames - 1, max(frames - 6, -1), -1) if len(views_at(k)) == len(poses)), None)
    if last is None or len(poses) < 3:
        return None

    def alone(frame: int) -> dict[int, float]:
        """Return by camera the least of its distances to the others."""
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
