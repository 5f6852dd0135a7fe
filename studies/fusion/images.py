"""All images of one sensor, read and cleaned; and its view of the cloth at rest, from those before it moves."""

from dataclasses import dataclass
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from fabdesign.depth.sensor import Sensor
from fabdesign.errors import InputError, note
from studies.fusion.clocks import Losses, begins_to_move, losses
from studies.fusion.cutting import Cutter
from studies.fusion.input import REST
from studies.fusion.joint import SensorView
from studies.fusion.moving import StampedView, with_speeds
from studies.fusion.ripple import ripple_of
from studies.measured.bad_data import Tolerance

Array = NDArray[np.float64]
REST_IMAGES, LEAST_REST = 12, 3
RIPPLE_IMAGES = 3  # that show a camera's ripple


@dataclass(frozen=True, eq=False)
class SensorImages:
    """One sensor's images as they were read."""

    sensor: Sensor
    cutter: Cutter
    views: list[StampedView]
    odd: Losses


def read_images(cutter: Cutter, sensor: Sensor, tolerance: Tolerance) -> SensorImages:
    """Read and clean all images of one sensor, in the order of their stamps; those that repeat the one before go."""
    stream = cutter.stream
    order = [int(k) for k in np.argsort(stream.stamps, kind="stable")]
    some = [order[k] for k in np.unique(np.linspace(0, len(order) - 1, RIPPLE_IMAGES).round().astype(int))]
    cutter.ripple = ripple_of([cutter.depth(k) for k in some], max(stream.camera.focal), cutter.pixel)
    clouds, same, last = {}, [], None
    for number in order:
        depth = cutter.depth(number)
        check = crc32(depth.tobytes())
        same.append(check == last)
        last = check
        with tolerance.forgiving():
            clouds[number] = cutter.clean(depth, f"{stream.where}, image {number}")
    counters = None if stream.numbers is None else stream.numbers[order]
    odd = losses(stream.stamps[order], counters, same)
    left_out = {order[k] for k in odd.repeated}
    numbers = [number for number in order if number in clouds and number not in left_out]
    if len(numbers) < 2:
        raise InputError(f"sensor {sensor.name}: {len(numbers)} sound images; expected at least 2")
    stamps = [float(stream.stamps[number]) for number in numbers]
    return SensorImages(sensor, cutter, with_speeds([clouds[number] for number in numbers], stamps, numbers), odd)


def view_at_rest(camera: SensorImages) -> tuple[Array, SensorView] | None:
    """Return a sensor's cloud of the cloth at rest and its view: the median of the images before the cloth moves; None
    where there are too few."""
    name, cutter = camera.sensor.name, camera.cutter
    before = begins_to_move(camera.views) - camera.odd.interval
    still = [view.number for view in camera.views if view.stamp < before]
    if len(still) < LEAST_REST:
        note(f"sensor {name}: {len(still)} images before the cloth moves; its pose stays near the nominal one")
        return None
    taken = [still[k] for k in np.unique(np.linspace(0, len(still) - 1, REST_IMAGES).round().astype(int))]
    depth = _median(np.array([cutter.depth(number) for number in taken]))
    return cutter.cloud(depth), SensorView(REST, 0, cutter.clean(depth, f"sensor {name} at rest"))


def _median(stack: Array) -> Array:
    """Return the median depth of pixels that have one in over half of the images; 0 elsewhere."""
    ordered = np.sort(stack, axis=0)  # zeros first
    there = (stack > 0).sum(axis=0)
    middle = len(stack) - there + there // 2
    depth = np.take_along_axis(ordered, np.minimum(middle, len(stack) - 1)[None], axis=0)[0]
    return np.asarray(np.where(2 * there > len(stack), depth, 0.0))
