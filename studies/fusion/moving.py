"""Views of a moving cloth: how fast each point moves along its ray, and the view at another instant.

A camera's other images say at which depth the same ray meets the cloth then. So a view can be had at any instant near
its own, and cameras that do not expose together become views of one instant. A step of pressure breaks the motion: its
acceleration jumps, and no polynomial through images of before and after it follows the cloth.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.nouns.array import Array
from studies.fusion.cleaning import Cleaned

MOST_DEPTH_CHANGE = 0.08  # m between two images; more is another surface
LEAST_SHARE = 0.2  # of a view's points whose motion is known


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
