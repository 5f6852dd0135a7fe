"""Views of a moving cloth: how fast each point moves along its ray, and the view at another instant.

A camera's next image says at which depth the same ray meets the cloth then. So a view can be had at any instant near
its own, and cameras that do not expose together become views of one instant.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from studies.fusion.cleaning import Cleaned

Array = NDArray[np.float64]
MOST_DEPTH_CHANGE = 0.08  # m between two images; more is another surface
LEAST_SHARE = 0.2  # of a view's points whose speed is known


@dataclass(frozen=True, eq=False)
class StampedView:
    """The view of one image by one camera: the cloth, and its points' speed and acceleration along their rays."""

    number: int  # of the image
    stamp: float  # s on the camera's clock
    cloud: Cleaned
    speed: Array  # (n,) m/s of depth; NaN where a neighbouring image has nothing
    acceleration: Array  # (n,) m/s^2

    @property
    def mean_speed(self) -> float:
        """Mean of how fast [m/s] the cloth moves, along the rays."""
        known = np.abs(self.speed[np.isfinite(self.speed)])
        return float(known.mean()) if len(known) > LEAST_SHARE * len(self.speed) else float("nan")

    def at(self, later: float) -> tuple[Cleaned, Array]:
        """Return the cloth so much later [s], and its points' velocities (n, 3) m/s in the camera's frame then; without
        points whose speed is not known."""
        known = np.isfinite(self.speed)
        if known.sum() < LEAST_SHARE * len(known):  # at rest, or alone
            return self.cloud, np.zeros_like(self.cloud.points)
        points = self.cloud.points[known]
        ray = points / points[:, 2:]
        speed, acceleration = self.speed[known, None], self.acceleration[known, None]
        there = points + ray * (speed * later + 0.5 * acceleration * later**2)
        cells = None if self.cloud.image_cells is None else self.cloud.image_cells[known]
        moved = Cleaned(there, self.cloud.normals[known], self.cloud.dropped, cells)
        return moved, ray * (speed + acceleration * later)


def with_speeds(clouds: Sequence[Cleaned], stamps: Sequence[float], numbers: Sequence[int]) -> list[StampedView]:
    """Return the views of one camera's images in the order of their stamps, with speeds by the images beside them."""
    views = []
    for k, cloud in enumerate(clouds):
        before = change(cloud, clouds[k - 1]) if k else np.full(len(cloud.points), np.nan)
        after = change(cloud, clouds[k + 1]) if k + 1 < len(clouds) else np.full(len(cloud.points), np.nan)
        h0 = stamps[k] - stamps[k - 1] if k else 1.0
        h1 = stamps[k + 1] - stamps[k] if k + 1 < len(clouds) else 1.0
        back, ahead = -before / h0, after / h1
        both = np.isfinite(back) & np.isfinite(ahead)
        acceleration = np.where(both, 2 * (ahead - back) / (h0 + h1), 0.0)
        one_sided = np.where(np.isfinite(back), back, ahead)
        speed = np.where(both, (ahead * h0 + back * h1) / (h0 + h1), one_sided)
        views.append(StampedView(numbers[k], float(stamps[k]), cloud, speed, acceleration))
    return views


def without_motion(view: StampedView) -> StampedView:
    """Return the view of a cloth at rest."""
    still = np.zeros(len(view.cloud.points))
    return replace(view, speed=still, acceleration=still)


def change(here: Cleaned, there: Cleaned) -> Array:
    """Return (n,) m: how much farther another view's surface lies along each ray of this one; NaN where it has none."""
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
