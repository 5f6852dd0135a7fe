"""Views of a moving cloth: how fast each point moves along its ray, and the view at another instant.

A camera's other images say at which depth the same ray meets the cloth then. So a view can be had at any instant near
its own, and cameras that do not expose together become views of one instant. A step of pressure breaks the motion: its
acceleration jumps, and no polynomial through images of before and after it follows the cloth.

The cameras' clocks on one axis, coarsely: how fast the cloth moves in each view, laid over the other views' by
cross-correlation; and which images were lost, repeated or late. studies/fusion/joint.py refines it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from studies.fusion.cleaning import Cleaned

MOST_DEPTH_CHANGE = 0.08  # m between two images; more is another surface
LEAST_SHARE = 0.2  # of a view's points whose motion is known
GRID = 0.004  # s
LEAST_OVERLAP = 0.5  # of the shorter of two views
SIMILAR = 0.6  # least correlation that says where a view lies
FAST = 0.05  # m/s, which no noise gives
MOVES = 4.0  # times the speed that noise gives
LOST, LATE = 1.5, 0.25  # of the interval: a gap beyond, an image off its place


@dataclass(frozen=True, eq=False)
class StampedView:
    """A camera's view in one image: the cloth, and its points' speed along their rays."""

    number: int  # of the image
    stamp: float  # s on the camera's clock
    cloud: Cleaned
    speed: Array  # (n,) m/s of depth; NaN where a neighbouring image has nothing

    @property
    def mean_speed(self) -> float:
        """Return the mean of how fast [m/s] the cloth moves, along the rays."""
        known = np.abs(self.speed[np.isfinite(self.speed)])
        return float(known.mean()) if len(known) > LEAST_SHARE * len(self.speed) else float("nan")


def with_speeds(clouds: Sequence[Cleaned], stamps: Sequence[float], numbers: Sequence[int]) -> list[StampedView]:
    """Return the views of one camera's images in the order of their stamps, with speeds by the images beside them."""
    views = []
    for k, cloud in enumerate(clouds):
        beside = [j for j in (k - 1, k + 1) if 0 <= j < len(clouds)]
        slopes = [change(cloud, clouds[j]) / (stamps[j] - stamps[k]) for j in beside]
        known = [np.where(np.isfinite(slope), slope, slopes[-1 - i]) for i, slope in enumerate(slopes)]
        steps = [abs(stamps[j] - stamps[k]) for j in beside]
        speed = np.average(known, axis=0, weights=steps[::-1]) if beside else np.full(len(cloud.points), np.nan)
        views.append(StampedView(numbers[k], float(stamps[k]), cloud, speed))
    return views


def view_at(
    views: Sequence[StampedView], times: Array, instant: float, steps: Sequence[float] = ()
) -> tuple[Cleaned, Array]:
    """Return the cloth at an instant [s] as a camera would see it, and its points' velocities (n, 3) m/s in the
    camera's frame; without points whose motion is not known.

    times: (images,) s of its images. steps: s, instants at which the cloth's acceleration jumps. The depth along each
    ray is a cubic through the four images about the instant. Where a step lies between the same two images it goes on
    as it came until the step, and from there through the images after it.
    """
    after = int(np.searchsorted(times, instant))
    images = [k for k in range(after - 2, after + 2) if 0 <= k < len(times)]
    step = next((s for s in steps if 1 < after < len(times) and times[after - 1] <= s < times[after]), None)
    if step is not None:
        images = [k for k in images if k >= after and instant > step]
    base = min(images or [after - 1], key=lambda k: abs(times[k] - instant))
    cloud = views[base].cloud

    def depth(k: int) -> Array:
        return change(cloud, views[k].cloud)

    images.sort(key=lambda k: abs(times[k] - instant))
    rows = [(times[k] - instant) ** np.arange(4) for k in images]  # conditions on a polynomial, the surest first
    values = [depth(k) for k in images]
    if step is not None:
        last, since = depth(after - 1), min(step, instant) - times[after - 1]
        slope = np.nan_to_num((last - depth(after - 2)) / (times[after - 1] - times[after - 2]))
        s = min(step, instant) - instant
        rows[1:1] = [s ** np.arange(4), np.arange(4) * np.append(0.0, s ** np.arange(3))]
        values[1:1] = [last + slope * since, slope]
    moved, speed = np.full((2, len(cloud.points)), np.nan)
    tried = [  # fewer conditions where an image has nothing there
        np.linalg.inv(np.array(rows)[:count, :count])[:2] @ np.array(values)[:count]
        for count in range(len(rows), 1, -1)
    ]
    for there, velocity in tried:
        moved, speed = np.where(np.isnan(moved), [there, velocity], [moved, speed])
    known = np.isfinite(moved)
    if known.sum() < LEAST_SHARE * len(known):  # alone
        return cloud, np.zeros_like(cloud.points)
    ray = cloud.points[known] / cloud.points[known, 2:]
    points = cloud.points[known] + ray * moved[known, None]
    return Cleaned(points, cloud.normals[known], cloud.dropped, cloud.cells[known]), ray * speed[known, None]


def change(here: Cleaned, there: Cleaned) -> Array:
    """Return (n,) m: how much farther another view's surface lies along each ray of this one; NaN where it has none."""
    if here is there:
        return np.zeros(len(here.points))
    unknown = np.full(len(here.points), np.nan)
    if not len(here.points) or not len(there.points):
        return unknown
    cells, others = here.cells, there.cells
    size = np.maximum(cells.max(axis=0), others.max(axis=0)) + 1
    place = np.full(size, -1)
    place[others[:, 0], others[:, 1]] = np.arange(len(others))
    at = place[cells[:, 0], cells[:, 1]]
    met = at >= 0
    ray = here.points[met] / here.points[met, 2:]
    normal = there.normals[at[met]]
    facing = np.einsum("ni,ni->n", normal, ray)
    depth = np.einsum("ni,ni->n", normal, there.points[at[met]]) / np.where(np.abs(facing) > 1e-3, facing, np.nan)
    change = depth - here.points[met, 2]
    unknown[met] = np.where(np.abs(change) < MOST_DEPTH_CHANGE, change, np.nan)
    return unknown


@dataclass(frozen=True)
class Clock:
    """The map from a camera's stamps to the common axis: time = stamp + offset + drift (stamp - middle)."""

    offset: float  # s
    drift: float = 0.0
    middle: float = 0.0  # s, on the camera's clock

    def times(self, stamps: Array | float) -> Array:
        """Return the common times [s] of stamps [s]."""
        return np.asarray(stamps + self.offset + self.drift * (stamps - self.middle))


@dataclass(frozen=True)
class Losses:
    """Irregularities in the stamps of one camera."""

    interval: float = 0.0  # s between images, the median
    lost: tuple[float, ...] = ()  # s, stamps at which an image should be
    repeated: tuple[int, ...] = ()  # numbers of images that repeat the one before
    late: tuple[int, ...] = ()  # numbers of images off their place by over LATE intervals


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
    middles = [0.5 * (stamps[0] + stamps[-1]) for stamps, _ in signals]
    clocks, similar = [Clock(0.0, 0.0, middles[0])], [1.0]
    for middle, (stamps, speeds) in zip(middles[1:], signals[1:], strict=True):
        start = 0.0 if shared else signals[0][0][0] - stamps[0]
        offset, correlation = best_lag(signals[0], (stamps + start, speeds), 0.25 if shared else np.inf)
        known = correlation > SIMILAR and _moves(speeds) and _moves(signals[0][1])
        clocks.append(Clock(start + (offset if known else 0.0), 0.0, middle))
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
