"""The cloth alone: what of a sensor's depth images is cut away before they are cleaned, and how much by what; all its
images; and its view of the cloth at rest, from those before it moves."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise, product
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fabdesign.depth.images import of_colour
from fabdesign.depth.sensor import Cut
from fabdesign.depth.stream import DepthStream, cloud_of
from fabdesign.errors import InputError, note
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric
from studies.fusion.cleaning import Cleaned, clean_image
from studies.fusion.joint import REST, SensorView
from studies.fusion.moving import Losses, StampedView, begins_to_move, losses, with_speeds
from studies.fusion.ripple import RIPPLE_IMAGES, Ripple, ripple_of
from studies.measured.splits import Tolerance

MARGIN = 0.03  # m around the box: what nominal poses are off
LEAST_PIXELS = 200
REST_IMAGES, LEAST_REST = 12, 3


@dataclass(eq=False)
class Cutter:
    """Reads the images of one sensor, cuts them by its pose, and counts the pixels that each rule took."""

    stream: DepthStream
    pose: Array  # camera_to_world (4, 4) m
    cut: Cut
    fabric: Fabric
    name: str = ""  # of the sensor
    predicted: Callable[[int], cKDTree] | None = None  # the simulated cloth's points in the world at an image's time
    ripple: Ripple | None = None  # that is taken off
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("box", "planes", "colour", "predicted"), 0))
    kept: int = 0
    views: list[StampedView] = field(default_factory=list)  # of its images, once they are read
    odd: Losses = field(default_factory=Losses)

    def __post_init__(self) -> None:
        camera = self.stream.camera
        low, high = self.cut.corners(self.fabric)
        self._low, self._high = low, high
        seen = (np.array([*product(*zip(low, high, strict=True))]) - self.pose[:3, 3]) @ self.pose[:3, :3]
        first, last = np.zeros(2, dtype=int), np.array([camera.width, camera.height])
        if (seen[:, 2] > 0.05).all():
            pixels = camera.pixels_of(seen[:, :2] / seen[:, 2:])
            beyond = MARGIN / float(seen[:, 2].min()) * max(camera.focal)
            first = np.clip(pixels.min(axis=0) - beyond, 0, last).astype(int)
            last = np.clip(np.ceil(pixels.max(axis=0) + beyond), 0, last).astype(int)
        self.part = slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))
        self._slopes = np.ascontiguousarray(camera.slopes[self.part])
        rays = np.concatenate([self._slopes, np.ones((*self._slopes.shape[:2], 1))], axis=2)
        self._rays = rays @ self.pose[:3, :3].T
        middle = np.array([0.0, -self.fabric.height / 2, 0.0])
        self.pixel = float(np.linalg.norm(self.pose[:3, 3] - middle)) / camera.focal[0]  # m on the cloth

    def depth(self, number: int) -> Array:
        """Return the part of an image (rows, columns) m that may be the cloth, 0 elsewhere. Raises InputError."""
        image = self.stream.depth(number)
        every = int(np.count_nonzero(image))
        depth: Array = np.asarray(image[self.part] * self.stream.unit, np.float64)
        world = self._rays * depth[..., None] + self.pose[:3, 3]
        inside = (depth > 0) & ((world > self._low) & (world < self._high)).all(axis=2)
        self.counts["box"] += every - int(inside.sum())
        for a, b, c, d in self.cut.planes:
            inside = self._without("planes", inside, world @ np.array([a, b, c]) >= d)
        if self.cut.colour is not None:
            inside = self._without("colour", inside, self._coloured(number, np.where(inside, depth, 0.0)))
        if self.predicted is not None and self.cut.predicted is not None:
            far, _ = self.predicted(number).query(world[inside], distance_upper_bound=self.cut.predicted)
            close = np.zeros_like(inside)
            close[inside] = np.isfinite(far)
            inside = self._without("predicted", inside, close)
        self.kept += int(inside.sum())
        depth = np.where(inside, depth, 0.0)
        return depth if self.ripple is None else self.ripple.without(depth)

    def _without(self, rule: str, inside: NDArray[np.bool_], kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
        self.counts[rule] += int((inside & ~kept).sum())
        return inside & kept

    def _coloured(self, number: int, depth: Array) -> NDArray[np.bool_]:
        """Return whether a pixel has the cloth's colour where the colour camera sees its point."""
        stream = self.stream
        if stream.colour is None or stream.colour_camera is None or self.cut.colour is None:
            raise InputError(f"{stream.where}: no colour images; expected some, to cut by colour")
        image = stream.colour(number)
        rows, columns = np.nonzero(depth)
        points = self.cloud(depth)
        if stream.depth_to_colour is not None:
            points = points @ stream.depth_to_colour[:, :3].T + stream.depth_to_colour[:, 3]
        pixels = stream.colour_camera.pixels_of(points[:, :2] / points[:, 2:]).round().astype(int)
        seen = ((pixels >= 0) & (pixels < [image.shape[1], image.shape[0]])).all(axis=1)
        kept = np.zeros(depth.shape, dtype=bool)
        shown = image[pixels[seen, 1], pixels[seen, 0]]
        kept[rows[seen], columns[seen]] = of_colour(shown[None], self.cut.colour)[0]
        return kept

    def clean(self, depth: Array, where: str) -> Cleaned:
        """Return the cleaned points of such a part of an image. Raises InputError for next to none."""
        if (depth > 0).sum() < LEAST_PIXELS:
            raise InputError(f"{where}: {int((depth > 0).sum())} pixels of the cloth; expected it in view")
        return clean_image(depth, self._slopes, self.pixel, (self.part[0].start, self.part[1].start))

    def cloud(self, depth: Array) -> Array:
        """Return the points (n, 3) m of such a part, as they were measured."""
        return cloud_of(depth, self._slopes)

    @property
    def shares(self) -> dict[str, float]:
        """Return by rule the share of all pixels with a depth that it cut."""
        every = self.kept + sum(self.counts.values())
        return {rule: count / max(every, 1) for rule, count in self.counts.items() if count or rule == "box"}

    def read(self, tolerance: Tolerance) -> None:
        """Read and clean all images, in the order of their stamps; those that repeat the one before go. Raises
        InputError."""
        stream = self.stream
        order = [int(k) for k in np.argsort(stream.stamps, kind="stable")]
        some = [order[k] for k in np.unique(np.linspace(0, len(order) - 1, RIPPLE_IMAGES).round().astype(int))]
        self.ripple = ripple_of([self.depth(k) for k in some], max(stream.camera.focal), self.pixel)
        clouds, checks = {}, []
        for number in order:
            depth = self.depth(number)
            checks.append(crc32(depth.tobytes()))
            with tolerance.forgiving():
                clouds[number] = self.clean(depth, f"{stream.where}, image {number}")
        counters = None if stream.numbers is None else stream.numbers[order]
        same = [False, *(a == b for a, b in pairwise(checks))]
        self.odd = losses(stream.stamps[order], counters, same)
        left_out = {order[k] for k in self.odd.repeated}
        numbers = [number for number in order if number in clouds and number not in left_out]
        if len(numbers) < 2:
            raise InputError(f"sensor {self.name}: {len(numbers)} sound images; expected at least 2")
        stamps = [float(stream.stamps[number]) for number in numbers]
        self.views = with_speeds([clouds[number] for number in numbers], stamps, numbers)

    def at_rest(self) -> tuple[Array, SensorView] | None:
        """Return the cloud of the cloth at rest and its view: the median of the images before the cloth moves, of
        pixels that have a depth in over half of them; None where there are too few."""
        before = begins_to_move(self.views) - self.odd.interval
        still = [view.number for view in self.views if view.stamp < before]
        if len(still) < LEAST_REST:
            note(f"sensor {self.name}: {len(still)} images before the cloth moves; its pose stays near the nominal one")
            return None
        taken = [still[k] for k in np.unique(np.linspace(0, len(still) - 1, REST_IMAGES).round().astype(int))]
        ordered = np.sort([self.depth(number) for number in taken], axis=0)  # zeros first
        there = (ordered > 0).sum(axis=0)
        middle = np.minimum(len(taken) - there + there // 2, len(taken) - 1)
        depth = np.where(2 * there > len(taken), np.take_along_axis(ordered, middle[None], axis=0)[0], 0.0)
        return self.cloud(depth), SensorView(REST, 0, self.clean(depth, f"sensor {self.name} at rest"))
