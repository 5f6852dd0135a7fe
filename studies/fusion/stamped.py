"""Recordings whose cameras stamp their images: from depth images to views at common instants, with poses and clocks.

Clocks are laid on one axis by how the cloth moves, coarsely (clocks.py) and with the poses (joint.py); the log of the
pressure joins by its steps (onset.py). A frame of the set is an instant at which each side has an image within half an
interval.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial

import numpy as np
from scipy.spatial import cKDTree

from fabdesign.clouds.recording import Recording
from fabdesign.depth.sensor import Sensor
from fabdesign.errors import InputError, note
from fabdesign.files.pressure_file import steps_of
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Case
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.nouns.trial import RecordingTiming, SensorTiming
from studies.fusion.checks import moved_camera
from studies.fusion.clocks import Clock, Losses, coarse_clocks
from studies.fusion.cutting import Cutter, SensorImages, read_images, view_at_rest
from studies.fusion.input import Anchored, anchor_sensors
from studies.fusion.joint import SensorView, TimedViews, align_timed
from studies.fusion.onset import pressure_offset
from studies.measured.splits import Tolerance

COARSELY = 0.01  # s, how well clocks are known by the motion alone
UNKNOWN = 0.03  # s, where it does not say it
STEADY, SLOW = 0.35, 0.02  # of the speed, and m/s: what it may change from image to image
JOINT = 20  # instants at which poses and clocks are fitted
MOST_VIEWS = 20_000
JUST_AFTER = 1e-4  # s
RATE, GRID = 60.0, 21  # Hz, and points a side of the simulated cloth; its faces have more


@dataclass(frozen=True, eq=False)
class StampedFrames:
    """The parts of a stamped recording that `fuse` needs."""

    recording: Recording
    anchored: Anchored
    cutters: tuple[Cutter, ...]
    poses: list[Array]
    timed: TimedViews
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
        steps = [self.offset + step for step, _ in steps_of(self.recording.program)]
        for time, instant in zip(self.times, self.instants, strict=True):
            yield float(time), self.timed.at(np.array([instant]), within, steps)

    def number(self, camera: int, time: float) -> int:
        """Return which image of a camera is nearest to a time [s after the pressure's 0]."""
        views, clock = self.timed.views[camera], self.timed.clocks[camera]
        times = clock.times(np.array([view.stamp for view in views]))
        return views[int(np.abs(times - time - self.offset).argmin())].number


def stamped_frames(recording: Recording, tolerance: Tolerance) -> StampedFrames:
    """Read all images of a recording and lay them on one axis; a second time where what is near to the predicted cloth
    is kept, since that needs times and poses. Raises InputError."""
    cutters = [
        Cutter(stream, sensor.camera_to_world, recording.cut, recording.design.fabric)
        for sensor, stream in zip(recording.sensors, recording.depth, strict=True)
    ]
    if recording.cut.predicted is None:
        return _frames_of(recording, cutters, tolerance)
    coarse = _frames_of(recording, cutters, Tolerance(True))
    cloth = predicted_cloth(recording)
    cutters = []
    for k, cutter in enumerate(coarse.cutters):
        clock, stamps = coarse.timed.clocks[k], cutter.stream.stamps
        times = clock.times(stamps) - coarse.offset
        fabric = recording.design.fabric
        cutters.append(Cutter(cutter.stream, coarse.poses[k], recording.cut, fabric, partial(_near, cloth, times)))
    used = replace(recording, sensors=coarse.anchored.sensors, depth=tuple(cutter.stream for cutter in cutters))
    return _frames_of(used, cutters, tolerance)


def _near(cloth: Callable[[float], cKDTree], times: Array, number: int) -> cKDTree:
    return cloth(float(times[number]))


def predicted_cloth(recording: Recording) -> Callable[[float], cKDTree]:
    """Return what gives the simulated cloth's points at a time [s after the pressure's 0], by the design as it is
    declared; before 0 and after the pressures' end as it was there."""
    from sim import Simulator

    program = recording.program
    times = np.arange(round(program.duration * RATE) + 1) / RATE
    case = Case(recording.design, program)
    points = Simulator(points_per_side=GRID).motions([case], [times])[0]

    @lru_cache(maxsize=16)
    def tree(index: int) -> cKDTree:
        return cKDTree(points[index])

    return lambda time: tree(int(np.clip(round(time * RATE), 0, len(times) - 1)))


def _frames_of(recording: Recording, cutters: Sequence[Cutter], tolerance: Tolerance) -> StampedFrames:
    images = sum(len(stream.stamps) for stream in recording.depth)
    if images > MOST_VIEWS:
        raise InputError(f"{recording.folder}: {images} images; expected at most {MOST_VIEWS}")
    cameras = []
    for sensor, cutter in zip(recording.sensors, cutters, strict=True):
        with tolerance.forgiving():
            cameras.append(read_images(cutter, sensor, tolerance))
    if not cameras:
        raise InputError(f"recording {recording.name}: no sensor is left")
    by_sensor = {camera.sensor.name: camera for camera in cameras}

    def at_rest(sensor: Sensor) -> tuple[Array, SensorView] | None:
        return view_at_rest(by_sensor[sensor.name])

    anchored = anchor_sensors(recording, tolerance, [camera.sensor for camera in cameras], at_rest)
    cameras = [by_sensor[sensor.name] for sensor in anchored.sensors]
    views, odd = [camera.views for camera in cameras], tuple(camera.odd for camera in cameras)
    clocks, similar = coarse_clocks(views, all(camera.cutter.stream.clock == "global" for camera in cameras))
    known = [COARSELY if np.isfinite(s) else UNKNOWN for s in similar]
    timed = TimedViews(views, clocks, known)
    instants = _instants(timed, odd)
    poses, timed, spread = _aligned(recording, anchored, timed, instants, tolerance)
    offset, uncertain, steps = _pressure(recording, timed)
    kept, left_out = _frames(recording.program, anchored, timed, instants, offset, odd[0].interval)
    timing = {
        camera.sensor.name: _timing(camera, timed, k, kept, spread[k], similar[k]) for k, camera in enumerate(cameras)
    }
    begins = timed.clocks[0].time(views[0][0].stamp)
    report = RecordingTiming(_us(odd[0].interval), left_out, _us(offset - begins), _us(uncertain), steps, timing)
    used = tuple(camera.cutter for camera in cameras)
    return StampedFrames(recording, anchored, used, poses, timed, kept, offset, report, odd)


def _us(seconds: float) -> float:
    """Return seconds to the microsecond."""
    return round(float(seconds), 6)


def _instants(timed: TimedViews, odd: Sequence[Losses]) -> Array:
    """Return the instants [s] of an even grid through the first camera's images."""
    stamps = np.array([view.stamp for view in timed.views[0]])
    interval = odd[0].interval
    place = np.cumsum(np.concatenate([[0], np.maximum(np.round(np.diff(stamps) / interval), 1)]))
    step, start = np.polyfit(place, stamps, 1) if len(stamps) > 2 else (interval, stamps[0])
    return timed.clocks[0].times(start + step * np.arange(int(place[-1]) + 1))


def _aligned(
    recording: Recording, anchored: Anchored, timed: TimedViews, instants: Array, tolerance: Tolerance
) -> tuple[list[Array], TimedViews, Array]:
    """Fit poses and clocks at the instants that move most and at some even ones. Raises InputError."""
    thickness = recording.design.fabric.thickness
    shown = _steady(timed)
    poses = [anchor.matrix for anchor in anchored.anchors]
    if anchored.rest:
        _require_unmoved(anchored, timed, instants, poses, thickness, tolerance)
    return align_timed(timed, shown, anchored.rest, anchored.anchors, anchored.sides, thickness)


def _steady(timed: TimedViews) -> Array:
    """Return instants [s] of the first camera at which the cloth moves smoothly: the fastest and some even ones.

    Where a step sets it in motion its speed jumps between two images, and no view at another instant follows from them.
    """
    speeds = [np.nan_to_num([view.mean_speed for view in views]) for views in timed.views]
    times = [c.times(np.array([v.stamp for v in images])) for images, c in zip(timed.views, timed.clocks, strict=True)]
    smooth = np.ones(len(times[0]), dtype=bool)
    for speed, when in zip(speeds, times, strict=True):
        change = np.abs(np.gradient(speed)) if len(speed) > 2 else np.zeros(len(speed))
        jumps = np.interp(times[0], when, (change > STEADY * speed + SLOW).astype(float))
        smooth &= jumps < 0.01
    kept = np.flatnonzero(smooth) if smooth.sum() >= JOINT // 2 else np.arange(len(smooth))
    fast = kept[np.argsort(-speeds[0][kept])[: JOINT // 2]]
    even = kept[np.unique(np.linspace(0, len(kept) - 1, JOINT // 2).round().astype(int))]
    return np.asarray(times[0][np.union1d(fast, even)])


def _require_unmoved(
    anchored: Anchored, timed: TimedViews, instants: Array, poses: list[Array], thickness: float, tolerance: Tolerance
) -> None:
    """Leave out the rest of a camera's images from where it was moved on, or raise InputError."""
    interval = float(np.median(np.diff(instants)))
    for _ in anchored.sensors:
        moved = moved_camera(
            lambda k: timed.at(instants[k : k + 1], interval), len(instants), poses, anchored.sides, thickness
        )
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


def _pressure(recording: Recording, timed: TimedViews) -> tuple[float, float, int]:
    """Return the common time [s] of the pressure's 0, how well it is known, and by how many steps."""
    if recording.log.shift is not None:
        return timed.clocks[0].time(timed.views[0][0].stamp) + recording.log.shift, 0.0, 0
    offset, uncertain, steps = pressure_offset(recording.program, timed.views, timed.clocks)
    if not np.isfinite(offset):
        note(
            f"recording {recording.name}: the pressures have no step; their 0 is taken to be the first image's instant"
        )
        return timed.clocks[0].time(timed.views[0][0].stamp), 0.0, 0
    return offset, uncertain, steps


def _frames(
    program: PressureProgram, anchored: Anchored, timed: TimedViews, instants: Array, offset: float, interval: float
) -> tuple[Array, int]:
    """Return the instants [s] within the program at which both sides have an image, and how many are left out."""
    times = instants - offset
    inside = instants[(times > JUST_AFTER) & (times <= program.duration + interval)]
    on_side = {side: np.zeros(len(inside), dtype=bool) for side in ("front", "back")}
    for camera, (views, clock) in enumerate(zip(timed.views, timed.clocks, strict=True)):
        camera_times = np.sort(clock.times(np.array([view.stamp for view in views])))
        at = np.clip(np.searchsorted(camera_times, inside), 1, len(camera_times) - 1)
        off = np.minimum(np.abs(camera_times[at] - inside), np.abs(camera_times[at - 1] - inside))
        on_side[anchored.sides[camera]] |= off <= 0.5 * interval
    both = on_side["front"] & on_side["back"]
    if not both.any():
        raise InputError(
            f"no frame within the pressures' {program.duration:g} s has an image of each side; expected recordings of "
            "one session"
        )
    return inside[both], int((~both).sum())


def _timing(
    camera: SensorImages, timed: TimedViews, column: int, instants: Array, spread: float, similar: float
) -> SensorTiming:
    """Return a camera's clock against the first's, and what became of its images."""
    clock, odd = timed.clocks[column], camera.odd
    camera_times = clock.times(np.array([view.stamp for view in camera.views]))
    nearest = np.abs(camera_times[:, None] - instants).argmin(axis=0)
    paired = len(np.unique(nearest[np.abs(camera_times[nearest] - instants) <= 0.5 * odd.interval]))
    first, last = instants[0] - 0.5 * odd.interval, instants[-1] + 0.5 * odd.interval
    within = int(((camera_times > first) & (camera_times < last)).sum())
    return SensorTiming(
        _us(_ahead(clock, timed.clocks[0])),
        -float(clock.drift),
        _us(spread) if column else 0.0,
        column == 0 or bool(np.isfinite(similar)),
        len(camera.cutter.stream.stamps),
        len(odd.lost),
        len(odd.repeated),
        len(odd.late),
        max(within - paired, 0),
    )


def _ahead(clock: Clock, first: Clock) -> float:
    """Return by how much [s] a clock's stamp is ahead of the first one's at the first one's middle."""
    at = first.time(first.middle)
    stamp = (at - clock.offset + clock.drift * clock.middle) / (1.0 + clock.drift)
    return stamp - first.middle
