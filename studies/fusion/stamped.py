"""Recordings whose cameras stamp their images: from depth images to views at common instants, with poses and clocks.

Clocks are laid on one axis by how the cloth moves, coarsely (clocks.py) and with the poses (joint.py); the log of the
pressure joins by its steps (onset.py). A frame of the set is an instant at which each side has an image within half an
interval.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from fabdesign.clouds.recording import Recording
from fabdesign.errors import InputError
from fabdesign.files.pressure_file import steps_of
from fabdesign.nouns.array import Array, Indices
from fabdesign.nouns.forward import Case
from fabdesign.nouns.trial import RecordingTiming, SensorTiming
from studies.fusion.cutting import Cutter
from studies.fusion.input import AlignedFrames, anchor_sensors
from studies.fusion.joint import Anchored, Arrangement, SensorView, TimedViews, align_timed
from studies.fusion.moving import coarse_clocks, places
from studies.fusion.onset import pressure_begin
from studies.measured.splits import Tolerance

COARSELY = 0.01  # s, how well clocks are known by the motion alone
UNKNOWN = 0.03  # s, where it does not say it
STEADY, SLOW = 0.35, 0.02  # of the speed, and m/s: what it may change from image to image
MOVED = 0.0025  # m: a camera so far from every other one was moved
JOINT = 20  # instants at which poses and clocks are fitted
MOST_VIEWS = 20_000
JUST_AFTER = 1e-4  # s
RATE, GRID = 60.0, 21  # Hz, and points a side of the simulated cloth; its faces have more


@dataclass(frozen=True, eq=False, kw_only=True)
class StampedFrames(AlignedFrames):
    """A recording whose images are stamped, on one axis."""

    timing: RecordingTiming
    cutters: Sequence[Cutter]
    timed: TimedViews
    instants: Array  # (T,) s on the common axis
    offset: float  # s, common time of the pressure's 0

    def frames(self) -> Iterator[tuple[int, float, Sequence[SensorView]]]:
        """Yield the number, the time [s] and the views of each frame."""
        within = 0.5 * self.timing.interval
        steps = [self.offset + step for step, _ in steps_of(self.recording.program)]
        for index, (time, instant) in enumerate(zip(self.times, self.instants, strict=True)):
            yield index, float(time), self.timed.at(np.array([instant]), within, steps)

    def number(self, camera: int, time: float) -> int:
        """Return which image of a camera is nearest to a time [s after the pressure's 0]."""
        off = np.abs(self.timed.times[camera] - time - self.offset)
        return self.timed.views[camera][int(off.argmin())].number

    def measured(self, camera: int, time: float) -> Array:
        """Return the cloud (n, 3) m of a camera's image nearest to a time [s], as it was measured."""
        cutter = self.cutters[camera]
        return cutter.cloud(cutter.depth(self.number(camera, time)))


def stamped_frames(recording: Recording, tolerance: Tolerance) -> StampedFrames:
    """Read all images of a recording and lay them on one axis; a second time where what is near to the predicted cloth
    is kept, since that needs times and poses. Raises InputError."""
    fabric = recording.design.fabric
    cutters = [
        Cutter(stream, sensor.camera_to_world, recording.cut, fabric, sensor.name)
        for sensor, stream in zip(recording.sensors, recording.depth, strict=True)
    ]
    if recording.cut.predicted is None:
        return _frames_of(recording, cutters, tolerance)
    coarse = _frames_of(recording, cutters, Tolerance(True))
    cloth = predicted_cloth(recording)

    def nearer(k: int, one: Cutter) -> Cutter:
        times = coarse.timed.clocks[k].times(one.stream.stamps) - coarse.offset
        pose, cut = coarse.poses[k], recording.cut
        return Cutter(one.stream, pose, cut, fabric, one.name, lambda number: cloth(float(times[number])))

    cutters = [nearer(k, cutter) for k, cutter in enumerate(coarse.cutters)]
    used = replace(recording, sensors=coarse.anchored.sensors, depth=tuple(cutter.stream for cutter in cutters))
    return _frames_of(used, cutters, tolerance)


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
    read: dict[str, Cutter] = {}
    for cutter in cutters:
        with tolerance.forgiving():
            cutter.read(tolerance)
            read[cutter.name] = cutter
    if not read:
        raise InputError(f"recording {recording.name}: no sensor is left")
    anchored = anchor_sensors(recording, tolerance, read)
    cameras = [read[sensor.name] for sensor in anchored.sensors]
    views, interval = [camera.views for camera in cameras], cameras[0].odd.interval
    clocks, similar = coarse_clocks(views, all(camera.stream.clock == "global" for camera in cameras))
    timed = TimedViews(views, clocks, [COARSELY if np.isfinite(s) else UNKNOWN for s in similar])
    stamps = np.array([view.stamp for view in views[0]])
    place = places(stamps, interval)
    step, start = np.polyfit(place, stamps, 1) if len(stamps) > 2 else (interval, stamps[0])
    instants = timed.clocks[0].times(start + step * np.arange(int(place[-1]) + 1))  # through the first camera's images
    shown = _steady(timed)
    if anchored.rest:
        timed = _while_unmoved(anchored, timed, instants, tolerance)
    aligned = align_timed(timed, shown, anchored)
    timed = timed.moved(aligned.clocks)
    offset, uncertain, steps = pressure_begin(recording, timed)
    kept, left_out = _paired(recording, anchored, timed, instants, offset, interval)
    timing = {c.name: _timing(c, timed, k, kept, aligned.spread[k], similar[k]) for k, c in enumerate(cameras)}
    begins = _us(offset - timed.times[0][0])
    return StampedFrames(
        recording=recording,
        anchored=anchored,
        poses=aligned.poses,
        times=np.round(kept - offset, 6),
        timing=RecordingTiming(_us(interval), left_out, begins, _us(uncertain), steps, timing),
        cutters=cameras,
        timed=timed,
        instants=kept,
        offset=offset,
    )


def _us(seconds: float) -> float:
    """Return seconds to the microsecond."""
    return round(float(seconds), 6)


def _steady(timed: TimedViews) -> Array:
    """Return instants [s] of the first camera at which the cloth moves smoothly: the fastest and some even ones.

    Where a step sets it in motion its speed jumps between two images, and no view at another instant follows from them.
    """
    times, speeds = timed.times, timed.speeds
    smooth = np.ones(len(times[0]), dtype=bool)
    for speed, when in zip(speeds, times, strict=True):
        change = np.abs(np.gradient(speed)) if len(speed) > 2 else np.zeros(len(speed))
        jumps = np.interp(times[0], when, (change > STEADY * speed + SLOW).astype(float))
        smooth &= jumps < 0.01
    kept = np.flatnonzero(smooth) if smooth.sum() >= JOINT // 2 else np.arange(len(smooth))
    fast = kept[np.argsort(-speeds[0][kept])[: JOINT // 2]]
    even = kept[np.unique(np.linspace(0, len(kept) - 1, JOINT // 2).round().astype(int))]
    return np.asarray(times[0][np.union1d(fast, even)])


def _while_unmoved(anchored: Anchored, timed: TimedViews, instants: Array, tolerance: Tolerance) -> TimedViews:
    """Return the views without those of a camera from where it was moved on, or raise InputError."""
    for _ in anchored.sensors:
        moved = _moved_camera(timed, instants, anchored.start)
        if moved is None:
            break
        camera, frame = moved
        since = float(instants[frame])
        name = anchored.sensors[camera].name
        tolerance.note(
            InputError(
                f"sensor {name}: its view leaves the others' from frame {frame} on, {since - float(instants[0]):.2f} s "
                "after the first; was it moved?"
            )
        )
        timed = timed.until(camera, since - 1e-3)
        if len(timed.views[camera]) < 2:
            raise InputError(f"sensor {name}: no image is left from before it was moved")
    return timed


def _moved_camera(timed: TimedViews, instants: Array, arranged: Arrangement) -> tuple[int, int] | None:
    """Return the camera whose views leave those of all others from a frame on, to the end, and that frame."""
    cameras, frames, interval = range(len(arranged.poses)), len(instants), float(np.median(np.diff(instants)))

    def views_at(frame: int) -> list[SensorView]:
        return timed.at(instants[frame : frame + 1], interval)

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


def _paired(
    recording: Recording, anchored: Anchored, timed: TimedViews, instants: Array, offset: float, interval: float
) -> tuple[Array, int]:
    """Return the instants [s] within the program at which both sides have an image, and how many are left out."""
    times, duration = instants - offset, recording.program.duration
    inside = instants[(times > JUST_AFTER) & (times <= duration + interval)]
    on_side = {side: np.zeros(len(inside), dtype=bool) for side in ("front", "back")}
    for camera, side in enumerate(anchored.start.sides):
        on_side[side] |= _nearest(timed, camera, inside)[0] <= 0.5 * interval
    both = on_side["front"] & on_side["back"]
    if not both.any():
        raise InputError(
            f"no frame within the pressures' {duration:g} s has an image of each side; expected recordings of one "
            "session"
        )
    return inside[both], int((~both).sum())


def _nearest(timed: TimedViews, camera: int, instants: Array) -> tuple[Array, Indices]:
    """Return how far [s] a camera's nearest image is from each instant, and which it is."""
    off, nearest = cKDTree(timed.times[camera][:, None]).query(instants[:, None])
    return off, nearest


def _timing(
    camera: Cutter, timed: TimedViews, column: int, instants: Array, spread: float, similar: float
) -> SensorTiming:
    """Return a camera's clock against the first's, and what became of its images."""
    clock, first, odd, times = timed.clocks[column], timed.clocks[0], camera.odd, timed.times[column]
    at = float(first.times(first.middle))
    ahead = (at - clock.offset + clock.drift * clock.middle) / (1.0 + clock.drift) - first.middle  # of its stamp then
    off, nearest = _nearest(timed, column, instants)
    paired = len(np.unique(nearest[off <= 0.5 * odd.interval]))
    within = (times > instants[0] - 0.5 * odd.interval) & (times < instants[-1] + 0.5 * odd.interval)
    return SensorTiming(
        _us(ahead),
        -float(clock.drift),
        _us(spread) if column else 0.0,
        column == 0 or bool(np.isfinite(similar)),
        len(camera.stream.stamps),
        len(odd.lost),
        len(odd.repeated),
        len(odd.late),
        max(int(within.sum()) - paired, 0),
    )
