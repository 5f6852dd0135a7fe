"""This module makes cleaned views and anchored poses from a recording; unsound parts are refused, or left out."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from fabdesign.clouds.recording import Recording
from fabdesign.depth.sensor import Sensor
from fabdesign.errors import InputError
from fabdesign.nouns.array import Array
from studies.fusion.checks import DISAGREE, disagreement, shifted_sensor, swapped_pair
from studies.fusion.cleaning import clean, clean_image, raster
from studies.fusion.joint import SensorView, align
from studies.fusion.reference import Pose, off, register_to_rest
from studies.fusion.ripple import RIPPLE_IMAGES, ripple_of
from studies.measured.splits import Tolerance

REST = -1  # the frame number of the reference
NOMINAL_ERROR = (np.radians(1.0), 0.005)  # rad and m that poses are taken to be off, where there is no reference


@dataclass(frozen=True, eq=False)
class Anchored:
    """Sensors that can be used, with what the cloth at rest says of their poses. A camera is an index into them."""

    sensors: tuple[Sensor, ...]
    anchors: tuple[Pose, ...]
    rest: tuple[SensorView, ...]  # of the reference

    @property
    def sides(self) -> list[str]:
        return [s.side for s in self.sensors]


def anchor_sensors(
    recording: Recording,
    tolerance: Tolerance,
    among: Sequence[Sensor] | None = None,
    at_rest: Callable[[Sensor], tuple[Array, SensorView] | None] | None = None,
) -> Anchored:
    """Register every sensor to the reference; without one, the nominal pose is the anchor. Raises InputError.

    at_rest: gives a sensor's cloud at rest and its view where there is no `reference`.
    """
    sensors: list[Sensor] = []
    anchors: list[Pose] = []
    rest: list[SensorView] = []
    for sensor in recording.sensors if among is None else among:
        with tolerance.forgiving():
            view = None
            if recording.has_reference():
                cloud = recording.reference(sensor)
                anchors.append(_registered(recording, sensor, cloud))
                view = SensorView(REST, len(sensors), clean(cloud))
            elif at_rest is not None and (seen := at_rest(sensor)) is not None:
                anchors.append(register_to_rest(sensor, seen[0], recording.design.fabric, seen[1].cloud))
                view = replace(seen[1], camera=len(sensors))
            else:
                turn, shift = NOMINAL_ERROR
                information = np.diag(np.repeat([turn**-2, shift**-2], 3))
                anchors.append(Pose(sensor.camera_to_world, information))
            sensors.append(sensor)
            rest += [view] if view is not None else []
    if {s.side for s in sensors} != {"front", "back"}:
        names = ", ".join(s.name for s in sensors) or "no sensor"
        raise InputError(f"recording {recording.name}: {names} left; expected sensors in front and at the back")
    return Anchored(tuple(sensors), tuple(anchors), tuple(rest))


def _registered(recording: Recording, sensor: Sensor, cloud: Array) -> Pose:
    fabric = recording.design.fabric
    try:
        return register_to_rest(sensor, cloud, fabric)
    except InputError:
        # seen through a flat sheet, the poses to the left in front and to the right behind look the same: whose own
        # cloud does not fit either is the other one
        fits: dict[str, tuple[bool, float]] = {}
        for other in recording.sensors:
            with suppress(InputError):
                distance = off(register_to_rest(other, cloud, fabric).matrix, other.camera_to_world)[1]
                fits[other.name] = _fits(recording, other), distance
        if not fits:
            raise
        nearest = min(fits, key=lambda name: fits[name])
        raise InputError(
            f"reference: the cloud of {sensor.name} fits the pose of {nearest}; are the two swapped?"
        ) from None


def _fits(recording: Recording, sensor: Sensor) -> bool:
    """Return whether a sensor's own cloud at rest fits its pose."""
    try:
        register_to_rest(sensor, recording.reference(sensor), recording.design.fabric)
    except InputError:
        return False
    return True


def read_views(recording: Recording, anchored: Anchored, tolerance: Tolerance) -> list[SensorView]:
    """Return every frame's clouds, cleaned, without the ripple that a sensor's clouds show. Raises InputError."""
    views = []
    for camera, sensor in enumerate(anchored.sensors):
        rasters = {}
        for frame in range(len(recording.times)):
            with tolerance.forgiving():
                rasters[frame] = raster(recording.frame(sensor, frame))
        frames = [*rasters]
        some = [rasters[k] for k in frames[:: max(len(frames) // RIPPLE_IMAGES, 1)]]
        ripple = ripple_of([each[0] for each in some], some[0][3], some[0][2]) if some else None
        for frame, (depth, slopes, pixel, _) in rasters.items():
            flat = depth if ripple is None else ripple.without(depth)
            views.append(SensorView(frame, camera, clean_image(flat, slopes, pixel)))
    return sorted(views, key=lambda view: (view.frame, view.camera))


def consistent(
    recording: Recording, anchored: Anchored, views: Sequence[SensorView], tolerance: Tolerance
) -> tuple[list[SensorView], list[Array]]:
    """Return the views of sound frames and the poses (4, 4) that all of them share. Raises InputError."""
    thickness, sides = recording.design.fabric.thickness, anchored.sides
    poses = [anchor.matrix for anchor in anchored.anchors]
    kept = list(views)
    if anchored.rest:
        kept = _without_swapped(recording, anchored, kept, poses, tolerance)
        kept = _without_late(anchored, kept, poses, thickness, tolerance)
    sound = []
    for frame in sorted({v.frame for v in kept}):
        mine = [v for v in kept if v.frame == frame]
        with tolerance.forgiving():
            if {sides[v.camera] for v in mine} != {"front", "back"}:
                raise InputError(
                    f"frame {frame}: no sensor left on one side; expected one in front and one at the back"
                )
            sound += mine
    if not sound:
        raise InputError(f"recording {recording.name}: no sound frame is left")
    return sound, align([*anchored.rest, *sound], anchored.anchors, sides, thickness)


def _without_swapped(
    recording: Recording, anchored: Anchored, views: list[SensorView], poses: list[Array], tolerance: Tolerance
) -> list[SensorView]:
    thickness, sides = recording.design.fabric.thickness, anchored.sides
    kept = []
    for frame in sorted({v.frame for v in views}):
        mine = [v for v in views if v.frame == frame]
        with tolerance.forgiving():
            if disagreement(mine, poses, sides, thickness) > DISAGREE:
                pair = swapped_pair(mine, poses, sides, thickness)
                if pair is not None:
                    a, b = (anchored.sensors[c].name for c in pair)
                    raise InputError(f"frame {frame}: the clouds of {a} and {b} look swapped")
            kept += mine
    return kept


def _without_late(
    anchored: Anchored, views: list[SensorView], poses: list[Array], thickness: float, tolerance: Tolerance
) -> list[SensorView]:
    frames = sorted({v.frame for v in views})
    worst = [disagreement([v for v in views if v.frame == f], poses, anchored.sides, thickness) for f in frames]
    shifted = (
        shifted_sensor(views, poses, anchored.sides, thickness) if max(worst, default=0.0) > DISAGREE / 2 else None
    )
    if shifted is None:
        return views
    camera, lags = shifted
    first = next(frame for frame, lag in lags.items() if lag)
    lag, name = lags[first], anchored.sensors[camera].name
    when = "later" if lag > 0 else "earlier"
    line = f"sensor {name}: its frames fit the others' {abs(lag)} frames {when}"
    same = len({lag for frame, lag in lags.items() if frame >= min(lags) + abs(lag)}) == 1
    tolerance.note(
        InputError(f"{line}; its clock differs" if same else f"{line} from frame {first} on; was one lost or repeated?")
    )
    moved = [replace(v, frame=v.frame + lags[v.frame]) if v.camera == camera else v for v in views]
    latest = {(v.frame, v.camera): v for v in moved if v.frame in lags}  # of two on one frame the later counts
    return list(latest.values())
