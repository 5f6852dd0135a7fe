"""The cameras' clocks on one axis, coarsely: how fast the cloth moves in each view, laid over the other views' by
cross-correlation; and which images were lost, repeated or late. studies/fusion/joint.py refines it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from studies.fusion.moving import StampedView

GRID = 0.004  # s
LEAST_OVERLAP = 0.5  # of the shorter of two views
SIMILAR = 0.6  # least correlation that says where a view lies
FAST = 0.05  # m/s, which no noise gives
MOVES = 4.0  # times the speed that noise gives
LOST, LATE = 1.5, 0.25  # of the interval: a gap beyond, an image off its place


@dataclass(frozen=True)
class Clock:
    """The map from a camera's stamps to the common axis: time = stamp + offset + drift (stamp - middle)."""

    offset: float  # s
    drift: float = 0.0
    middle: float = 0.0  # s, on the camera's clock

    def time(self, stamp: float) -> float:
        """Return the common time [s] of a stamp [s]."""
        return stamp + self.offset + self.drift * (stamp - self.middle)

    def times(self, stamps: Array) -> Array:
        """Return the common times [s] of stamps [s]."""
        return np.asarray(stamps + self.offset + self.drift * (stamps - self.middle))


@dataclass(frozen=True)
class Losses:
    """Irregularities in the stamps of one camera."""

    interval: float  # s between images, the median
    lost: tuple[float, ...]  # s, stamps at which an image should be
    repeated: tuple[int, ...]  # numbers of images that repeat the one before
    late: tuple[int, ...]  # numbers of images off their place by over LATE intervals


NOTHING_LOST = Losses(0.0, (), (), ())


def losses(stamps: Array, counters: NDArray[np.int64] | None, same: Sequence[bool]) -> Losses:
    """Return what is odd. counters: of the camera, where it counts. same: whether an image equals the one before it."""
    gaps = np.diff(stamps)
    interval = float(np.median(gaps[gaps > 0])) if (gaps > 0).any() else 0.0
    soon = 1 + np.flatnonzero(gaps < 0.5 * interval)
    repeated = np.union1d(soon, 1 + np.flatnonzero(same[1:]))
    kept = np.setdiff1d(np.arange(len(stamps)), soon)
    lost: list[float] = []
    for a, b in pairwise(kept):
        gap = stamps[b] - stamps[a]
        missing = round(gap / interval) - 1 if interval and gap > LOST * interval else 0
        if counters is not None and 0 < counters[b] - counters[a] < 10_000:
            missing = max(missing, int(counters[b] - counters[a]) - 1)
        lost += [float(stamps[a] + gap * (k + 1) / (missing + 1)) for k in range(min(missing, 10_000))]
    late = kept[:0]
    if len(kept) > 3 and interval:
        place = places(stamps[kept], interval)
        late = kept[stamps[kept] - np.polyval(np.polyfit(place, stamps[kept], 1), place) > LATE * interval]
    return Losses(interval, tuple(lost), tuple(repeated.tolist()), tuple(late.tolist()))


def places(stamps: Array, interval: float) -> Array:
    """Return how many intervals [s] each of a camera's stamps is after the first one, at least one after another."""
    return np.asarray(np.cumsum(np.concatenate([[0], np.maximum(np.round(np.diff(stamps) / interval), 1)])))


def coarse_clocks(views: Sequence[Sequence[StampedView]], shared: bool) -> tuple[list[Clock], list[float]]:
    """Return each camera's clock against the first one's, and the correlation that says so.

    It is NaN where the cloth moves too little: then clocks that are `shared` agree, and others began together.
    """
    signals = [_signal(images) for images in views]
    clocks, similar = [Clock(0.0, 0.0, _middle(views[0]))], [1.0]
    for images, (stamps, speeds) in zip(views[1:], signals[1:], strict=True):
        start = 0.0 if shared else signals[0][0][0] - stamps[0]
        offset, correlation = best_lag(signals[0], (stamps + start, speeds), 0.25 if shared else np.inf)
        known = correlation > SIMILAR and _moves(speeds) and _moves(signals[0][1])
        clocks.append(Clock(start + (offset if known else 0.0), 0.0, _middle(images)))
        similar.append(correlation if known else float("nan"))
    return clocks, similar


def _moves(speeds: Array) -> bool:
    """Return whether speeds [m/s] are more than noise."""
    return bool(speeds.max() > max(MOVES * float(np.quantile(speeds, 0.1)), 2e-3) or speeds.max() > FAST)


def begins_to_move(views: Sequence[StampedView]) -> float:
    """Return the stamp [s] before which a camera's cloth is at rest; its first stamp where it moves all along."""
    stamps, speeds = _signal(views)
    quiet = max(float(np.quantile(speeds, 0.1)), 1e-4)
    moving = np.flatnonzero(speeds > max(MOVES * quiet, 0.1 * float(speeds.max())))
    return float(stamps[max(moving[0] - 1, 0)] if len(moving) else stamps[-1])


def _middle(views: Sequence[StampedView]) -> float:
    return 0.5 * (views[0].stamp + views[-1].stamp)


def _signal(views: Sequence[StampedView]) -> tuple[Array, Array]:
    """Return stamps [s] and mean speeds [m/s], what noise gives taken off."""
    stamps = np.array([view.stamp for view in views])
    speeds = np.array([view.mean_speed for view in views])
    known = np.isfinite(speeds)
    if not known.any():
        return stamps, np.zeros(len(stamps))
    return stamps, np.interp(stamps, stamps[known], speeds[known])


def best_lag(one: tuple[Array, Array], other: tuple[Array, Array], most: float) -> tuple[float, float]:
    """Return by how much [s] the other signal must be moved, at most so far, to lie on the first; their correlation."""
    grids = [np.arange(stamps[0], stamps[-1], GRID) for stamps, _ in (one, other)]
    a, b = (np.interp(g, *s) for g, s in zip(grids, (one, other), strict=True))
    if min(len(a), len(b)) < 8 or a.std() < 1e-9 or b.std() < 1e-9:
        return 0.0, 0.0
    least = int(LEAST_OVERLAP * min(len(a), len(b)))
    base = grids[0][0] - grids[1][0]
    best, at, correlation = -np.inf, 0, 0.0
    for lag in range(least - len(b), len(a) - least + 1):  # b[k] lies on a[k + lag]
        if abs(lag * GRID + base) > most:
            continue
        begin, end = max(lag, 0), min(len(a), len(b) + lag)
        x, y = a[begin:end], b[begin - lag : end - lag]
        x, y = x - x.mean(), y - y.mean()
        size = float(np.sqrt((x @ x) * (y @ y)))
        score = float(x @ y) / size if size > 0 else -1.0
        if score * np.sqrt(end - begin) > best:  # a short overlap agrees by chance
            best, at, correlation = score * np.sqrt(end - begin), lag, score
    return at * GRID + base, correlation
