"""Recordings whose cameras stamp their images: from depth images to views at common instants, with poses and clocks.

Clocks are laid on one axis by how the cloth moves, coarsely (clocks.py) and with the poses (joint.py); the pressure's log
joins by its steps (onset.py). A frame of the set is an instant at which each side has an image within half an interval.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.recording import Recording, Sensor
from fabdesign.depth.timing import RecordingTiming, SensorTiming
from fabdesign.errors import InputError, note
from fabdesign.nouns.pressure import PressureProgram
from studies.fusion.checks import moved_camera
from studies.fusion.clocks import Clock, Losses, begins_to_move, coarse_clocks, losses
from studies.fusion.cutting import Cutter
from studies.fusion.input import REST, Anchored, anchor_sensors
from studies.fusion.joint import SensorView, Timed, align_timed
from studies.fusion.moving import StampedView, with_speeds
from studies.fusion.onset import pressure_offset
from studies.measured.bad_data import Tolerance

Array = NDArray[np.float64]
COARSELY = 0.01  # s, how well clocks are known by the motion alone
UNKNOWN = 0.03  # s, where it does not say it
JOINT = 20  # instants at which poses and clocks are fitted
REST_IMAGES, LEAST_REST = 12, 3
MOST_VIEWS = 20_000
JUST_AFTER = 1e-4  # s


@dataclass(frozen=True, eq=False)
class StampedFrames:
    """What `fuse` needs of a stamped recording."""

    recording: Recording
    anchored: Anchored
    cutters: tuple[Cutter, ...]
    poses: list[Array]
    timed: Timed
    instants: Array  # (T,) s on the common axis
    offset: float  # s, common time of the pressure's 0
    timing: RecordingTiming
    odd: tuple[Losses, ...]

    @cached_property
    def times(self) -> Array:
        """(T,) s after the pressure's 0."""
        return np.round(self.instants - self.offset, 6)

    def frames(self) -> Iterator[tuple[float, list[SensorView]]]:
        """Yield the time [s] and the views of each frame."""
        within = 0.5 * self.timing.interval
        for time, instant in zip(self.times, self.instants, strict=True):
            yield float(time), self.timed.at(np.array([instant]), within)

    def number(self, camera: int, time: float) -> int:
        """Return which image of a camera is nearest to a time [s after the pressure's 0]."""
        views, clock = self.timed.views[camera], self.timed.clocks[camera]
        times = clock.times(np.array([view.stamp for view in views]))
        return views[int(np.abs(times - time - self.offset).argmin())].number


def stamped_frames(recording: Recording, tolerance: Tolerance) -> StampedFrames:
    """Read all images of a recording and lay them on one axis. Raises InputError."""
    fabric = recording.design.fabric
    images = sum(len(stream.stamps) for stream in recording.depth)
    if images > MOST_VIEWS:
        raise InputError(f"{recording.folder}: {images} images; expected at most {MOST_VIEWS}")
    sensors, cutters, views, odd = [], [], [], []
    for sensor, stream in zip(recording.sensors, recording.depth, strict=True):
        with tolerance.forgiving():
            cutter = Cutter(stream, sensor.camera_to_world, recording.cut, fabric)
            seen, strange = _views(cutter, sensor, tolerance)
            sensors.append(sensor)
            cutters.append(cutter)
            views.append(seen)
            odd.append(strange)
    if not views:
        raise InputError(f"recording {recording.name}: no sensor is left")
    shared = all(cutter.stream.clock == "global" for cutter in cutters)
    clocks, similar = coarse_clocks(views, shared)
    begins = [begins_to_move(own) for own in views]
    rest = _at_rest(recording, sensors, cutters, views, begins)
    anchored = anchor_sensors(recording, tolerance, sensors, rest)
    if len(anchored.sensors) < len(sensors):
        kept = [sensors.index(sensor) for sensor in anchored.sensors]
        cutters, views, odd, clocks, similar = (
            [part[k] for k in kept] for part in (cutters, views, odd, clocks, similar)
        )
    known = [COARSELY if np.isfinite(s) else UNKNOWN for s in similar]
    timed = Timed(views, clocks, known)
    instants = _instants(timed, odd)
    poses, timed, spread = _aligned(recording, anchored, timed, instants, tolerance)
    offset, uncertain, steps = _pressure(recording, timed)
    kept_instants, left_out = _frames(recording.program, anchored, timed, instants, offset, odd[0].interval)
    timing = _timing(anchored.sensors, cutters, timed, odd, similar, spread, kept_instants)
    report = RecordingTiming(
        odd[0].interval, left_out, offset - clocks[0].time(_first(views[0])), uncertain, steps, timing
    )
    return StampedFrames(
        recording, anchored, tuple(cutters), poses, timed, kept_instants, offset, report, tuple(odd)
    )  # fmt: skip


def _first(views: Sequence[StampedView]) -> float:
    return views[0].stamp


def _views(cutter: Cutter, sensor: Sensor, tolerance: Tolerance) -> tuple[list[StampedView], Losses]:
    """Read and clean all images of one sensor, in the order of their stamps; those that repeat the one before go."""
    stream = cutter.stream
    order = np.argsort(stream.stamps, kind="stable")
    clouds, numbers, same, last = {}, [], [], None
    for number in map(int, order):
        try:
            depth = cutter.depth(number)
            equal = crc32(np.ascontiguousarray(depth).view(np.uint8))
            same.append(equal == last)
            last = equal
            clouds[number] = cutter.clean(depth, f"{stream.where}, image {number}")
            numbers.append(number)
        except InputError as error:
            tolerance.note(error)
            same += [False] * (len(same) < len(order) and len(same) == len(clouds))
    same = (same + [False] * len(order))[: len(order)]
    counters = None if stream.numbers is None else stream.numbers[order]
    strange = losses(stream.stamps[order], counters, same)
    left_out = {int(order[k]) for k in strange.repeated}
    numbers = [number for number in numbers if number not in left_out]
    if len(numbers) < 2:
        raise InputError(f"sensor {sensor.name}: {len(numbers)} sound images; expected at least 2")
    stamps = [float(stream.stamps[number]) for number in numbers]
    return with_speeds([clouds[number] for number in numbers], stamps, numbers), strange


def _at_rest(
    recording: Recording,
    sensors: Sequence[Sensor],
    cutters: Sequence[Cutter],
    views: Sequence[Sequence[StampedView]],
    begins: Sequence[float],
) -> Callable[[Sensor], tuple[Array, SensorView] | None]:
    """Return what gives a sensor's cloud of the cloth at rest and its view: of `reference`, or the median of the images
    before the cloth moves; None where there are too few."""

    def rest(sensor: Sensor) -> tuple[Array, SensorView] | None:
        camera = sensors.index(sensor)
        cutter = cutters[camera]
        interval = float(np.median(np.diff([view.stamp for view in views[camera]])))
        still = [view.number for view in views[camera] if view.stamp < begins[camera] - interval]
        if len(still) < LEAST_REST:
            note(f"sensor {sensor.name}: {len(still)} images before the cloth moves; poses stay near the nominal ones")
            return None
        taken = [still[k] for k in np.unique(np.linspace(0, len(still) - 1, REST_IMAGES).round().astype(int))]
        stack = np.array([cutter.depth(number) for number in taken])
        depth = _median(stack)
        return cutter.cloud(depth), SensorView(REST, camera, cutter.clean(depth, f"sensor {sensor.name} at rest"))

    return rest


def _median(stack: Array) -> Array:
    """Return the median depth of pixels that have one in over half of the images; 0 elsewhere."""
    ordered = np.sort(stack, axis=0)  # zeros first
    there = (stack > 0).sum(axis=0)
    middle = len(stack) - there + there // 2
    depth = np.take_along_axis(ordered, np.minimum(middle, len(stack) - 1)[None], axis=0)[0]
    return np.asarray(np.where(2 * there > len(stack), depth, 0.0))


def _instants(timed: Timed, odd: Sequence[Losses]) -> Array:
    """Return the instants [s] of an even grid through the first camera's images."""
    stamps = np.array([view.stamp for view in timed.views[0]])
    interval = odd[0].interval
    place = np.cumsum(np.concatenate([[0], np.maximum(np.round(np.diff(stamps) / interval), 1)]))
    step, start = np.polyfit(place, stamps, 1) if len(stamps) > 2 else (interval, stamps[0])
    return timed.clocks[0].times(start + step * np.arange(int(place[-1]) + 1))


def _aligned(
    recording: Recording, anchored: Anchored, timed: Timed, instants: Array, tolerance: Tolerance
) -> tuple[list[Array], Timed, Array]:
    """Fit poses and clocks at the instants that move most and at some even ones. Raises InputError."""
    thickness = recording.design.fabric.thickness
    speed = np.array([view.mean_speed for view in timed.views[0]])
    fast = np.argsort(-np.nan_to_num(speed))[: JOINT // 2]
    when = timed.clocks[0].times(np.array([timed.views[0][k].stamp for k in fast]))
    even = instants[
        np.unique(np.linspace(1, max(len(instants) - 2, 1), JOINT // 2).round().astype(int) % len(instants))
    ]
    shown = np.unique(np.concatenate([when, even]))
    poses = [anchor.matrix for anchor in anchored.anchors]
    if anchored.rest:
        _require_unmoved(anchored, timed, instants, poses, thickness, tolerance)
    return align_timed(timed, shown, anchored.rest, anchored.anchors, anchored.sides, thickness)


def _require_unmoved(
    anchored: Anchored, timed: Timed, instants: Array, poses: list[Array], thickness: float, tolerance: Tolerance
) -> None:
    """Leave out the rest of a camera's images from where it was moved on, or raise InputError."""
    for _ in anchored.sensors:
        moved = moved_camera(lambda k: timed.at(instants[k : k + 1]), len(instants), poses, anchored.sides, thickness)
        if moved is None:
            return
        camera, frame = moved
        since = float(instants[frame])
        name = anchored.sensors[camera].name
        tolerance.note(
            InputError(
                f"sensor {name}: its view leaves the others' from frame {frame} on, {since - float(instants[0]):.2f} s "
                "after the first; was it moved?"
            )
        )
        views, clock = timed.views[camera], timed.clocks[camera]
        del views[next(k for k, v in enumerate(views) if clock.time(v.stamp) > since - 1e-3) :]  # type: ignore[attr-defined]
        if len(views) < 2:
            raise InputError(f"sensor {name}: no image is left from before it was moved")


def _pressure(recording: Recording, timed: Timed) -> tuple[float, float, int]:
    """Return the common time [s] of the pressure's 0, how well it is known, and by how many steps."""
    if recording.log.shift is not None:
        return timed.clocks[0].time(_first(timed.views[0])) + recording.log.shift, 0.0, 0
    offset, uncertain, steps = pressure_offset(recording.program, timed.views, timed.clocks)
    if not np.isfinite(offset):
        note(
            f"recording {recording.name}: the pressures have no step; their 0 is taken to be the first image's instant"
        )
        return timed.clocks[0].time(_first(timed.views[0])), 0.0, 0
    return offset, uncertain, steps


def _frames(
    program: PressureProgram, anchored: Anchored, timed: Timed, instants: Array, offset: float, interval: float
) -> tuple[Array, int]:
    """Return the instants [s] within the program at which both sides have an image, and how many are left out."""
    times = instants - offset
    inside = instants[(times > JUST_AFTER) & (times <= program.duration + interval)]
    on_side = {side: np.zeros(len(inside), dtype=bool) for side in ("front", "back")}
    for camera, (views, clock) in enumerate(zip(timed.views, timed.clocks, strict=True)):
        own = np.sort(clock.times(np.array([view.stamp for view in views])))
        at = np.clip(np.searchsorted(own, inside), 1, len(own) - 1)
        off = np.minimum(np.abs(own[at] - inside), np.abs(own[at - 1] - inside))
        on_side[anchored.sides[camera]] |= off <= 0.5 * interval
    both = on_side["front"] & on_side["back"]
    if not both.any():
        raise InputError(
            f"no frame within the pressures' {program.duration:g} s has an image of each side; expected recordings of "
            "one session"
        )
    return inside[both], int((~both).sum())


def _timing(
    sensors: Sequence[Sensor],
    cutters: Sequence[Cutter],
    timed: Timed,
    odd: Sequence[Losses],
    similar: Sequence[float],
    spread: Array,
    instants: Array,
) -> dict[str, SensorTiming]:
    """Return each camera's clock against the first's: raw stamps at one instant, and what became of its images."""
    first = timed.clocks[0]
    timing = {}
    for k, (sensor, cutter, clock, strange) in enumerate(zip(sensors, cutters, timed.clocks, odd, strict=True)):
        own = clock.times(np.array([view.stamp for view in timed.views[k]]))
        nearest = np.abs(own[:, None] - instants).argmin(axis=0)
        within = np.abs(own[nearest] - instants) <= 0.5 * strange.interval
        timing[sensor.name] = SensorTiming(
            float(_ahead(clock, first)),
            -clock.drift,
            0.0 if k == 0 else float(spread[k]),
            k == 0 or bool(np.isfinite(similar[k])),
            len(cutter.stream.stamps),
            len(strange.lost),
            len(strange.repeated),
            len(strange.late),
            len(timed.views[k]) - len(np.unique(nearest[within])),
        )
    return timing


def _ahead(clock: Clock, first: Clock) -> float:
    """Return by how much [s] a clock's stamp is ahead of the first one's at the first one's middle."""
    at = first.time(first.middle)
    stamp = (at - clock.offset + clock.drift * clock.middle) / (1.0 + clock.drift)
    return stamp - first.middle
