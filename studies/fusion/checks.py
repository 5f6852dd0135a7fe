"""This module finds errors of a rig in the clouds themselves: swapped sensors, clocks that differ."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from studies.fusion.joint import Arrangement, SensorView

BETTER = 0.5  # what a swap or another frame must leave of the distances
LAGS = (-2, -1, 0, 1, 2)  # frames
CHANGE = 0.001  # m: what a change of the lag by one must save in distances, summed over frames
UNKNOWN = 0.0005  # m: a frame without partners
MOVED = 0.0025  # m: a camera so far from every other one was moved


def disagreement(views: Sequence[SensorView], arranged: Arrangement) -> float:
    """Return the median distance [m] between the sensors of one frame; points without a partner count as far."""
    gaps = [arranged.gap(a, b) for a, b in combinations(views, 2)]
    return float(np.median(gaps)) if gaps else 0.0


def swapped_pair(views: Sequence[SensorView], arranged: Arrangement) -> tuple[int, int] | None:
    """Return the front and back cameras whose clouds must be exchanged for the frame to agree, if that is wrong."""
    remaining = {}
    for a, b in combinations([v.camera for v in views], 2):
        if arranged.sides[a] != arranged.sides[b]:
            exchanged = [replace(v, camera={a: b, b: a}.get(v.camera, v.camera)) for v in views]
            remaining[a, b] = disagreement(exchanged, arranged)
    best = min(remaining, key=remaining.__getitem__, default=None)
    return best if best and remaining[best] < BETTER * disagreement(views, arranged) else None


def shifted_sensor(views: Sequence[SensorView], arranged: Arrangement) -> tuple[int, dict[int, int]] | None:
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
            view = by_place.get((frame, camera))
            for j, lag in enumerate(LAGS):
                others = [by_place.get((frame + lag, other)) for other in cameras if other != camera]
                gaps = [arranged.gap(view, other) for other in others if view and other]
                cost[i, j] = float(np.mean(gaps)) if gaps else UNKNOWN
        path = _cheapest(cost)
        before = float(cost[:, LAGS.index(0)].mean())
        gain = float(np.mean([cost[i, j] for i, j in enumerate(path)])) / before if before > 0 else 1.0
        lags = {frame: LAGS[j] for frame, j in zip(frames, path, strict=True)}
        if any(lags.values()) and gain < BETTER and (best is None or gain < best[0]):
            best = gain, (camera, lags)
    return None if best is None else best[1]


def _cheapest(cost: NDArray[np.float64]) -> list[int]:
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
    views_at: Callable[[int], Sequence[SensorView]], frames: int, arranged: Arrangement
) -> tuple[int, int] | None:
    """Return the camera whose views leave those of all others from a frame on, to the end, and that frame."""
    cameras = range(len(arranged.poses))
    last = next((k for k in range(frames - 1, max(frames - 6, -1), -1) if len(views_at(k)) == len(cameras)), None)
    if last is None or len(cameras) < 3:
        return None

    def alone(frame: int) -> dict[int, float]:
        """Return by camera the least of its distances to the others."""
        least = dict.fromkeys(cameras, np.inf)
        for a, b in combinations(views_at(frame), 2):
            gap = arranged.gap(a, b)
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
