"""This module makes cleaned views and anchored poses from a recording; unsound parts are refused, or left out: swapped
sensors, clocks that differ, cameras that were moved are seen in the clouds themselves."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from operator import itemgetter

import numpy as np

from fabdesign.clouds.recording import Recording
from fabdesign.depth.sensor import Sensor
from fabdesign.errors import InputError
from fabdesign.nouns.array import Array
from fabdesign.nouns.trial import RecordingTiming
from studies.fusion.cleaning import clean, clean_image, raster
from studies.fusion.cutting import Cutter
from studies.fusion.joint import DISAGREE, REST, Anchored, Arrangement, SensorView, align
from studies.fusion.reference import Pose, off, register_to_rest
from studies.fusion.ripple import RIPPLE_IMAGES, ripple_of
from studies.measured.splits import Tolerance

BETTER = 0.5  # what a swap or another frame must leave of the distances
LAGS = (-2, -1, 0, 1, 2)  # frames
CHANGE = 0.001  # m: what a change of the lag by one must save in distances, summed over frames
UNKNOWN = 0.0005  # m: a frame without partners
NOMINAL_ERROR = (np.radians(1.0), 0.005)  # rad and m that poses are taken to be off, where there is no reference


@dataclass(frozen=True, eq=False, kw_only=True)
class AlignedFrames:
    """A recording as it is fused: poses that all frames share, and the views of each frame."""

    recording: Recording
    anchored: Anchored
    poses: Sequence[Array]  # (4, 4)
    times: Array  # (T,) s after the pressure's 0
    views: Sequence[Sequence[SensorView]] = ()  # of each frame; of stamped images they are made when asked for
    timing: RecordingTiming | None = None  # of cameras that stamp their images
    cutters: Sequence[Cutter] = ()  # of depth images

    def frames(self) -> Iterator[tuple[int, float, Sequence[SensorView]]]:
        """Yield the number, the time [s] and the views of each frame."""
        for time, views in zip(self.times, self.views, strict=True):
            yield views[0].frame, float(time), views

    def measured(self, camera: int, time: float) -> Array:
        """Return the cloud (n, 3) m of a camera at a frame's time [s], as it was measured."""
        index = int(np.searchsorted(self.recording.times, time))
        return self.recording.frame(self.anchored.sensors[camera], index)


def anchor_sensors(recording: Recording, tolerance: Tolerance, cutters: Mapping[str, Cutter] | None = None) -> Anchored:
    """Register every sensor to the reference; without one, the nominal pose is the anchor. Raises InputError.

    cutters: of depth images, by the names of the sensors that are left: they see the cloth at rest where there is no
    `reference`.
    """
    sensors: list[Sensor] = []
    anchors: list[Pose] = []
    rest: list[SensorView] = []
    fabric = recording.design.fabric
    for sensor in recording.sensors:
        if cutters is not None and sensor.name not in cutters:
            continue
        with tolerance.forgiving():
            view = None
            if recording.has_reference():
                cloud = recording.reference(sensor)
                anchors.append(_registered(recording, sensor, cloud))
                view = SensorView(REST, len(sensors), clean(cloud))
            elif cutters and (seen := cutters[sensor.name].at_rest()) is not None:
                anchors.append(register_to_rest(sensor, seen[0], fabric, seen[1].cloud))
                view = replace(seen[1], camera=len(sensors))
            else:
                anchors.append(Pose.within(sensor.camera_to_world, *NOMINAL_ERROR))
            sensors.append(sensor)
            rest += [view] if view is not None else []
    if {s.side for s in sensors} != {"front", "back"}:
        names = ", ".join(s.name for s in sensors) or "no sensor"
        raise InputError(f"recording {recording.name}: {names} left; expected sensors in front and at the back")
    start = Arrangement([anchor.matrix for anchor in anchors], [s.side for s in sensors], fabric.thickness)
    return Anchored(tuple(sensors), tuple(anchors), tuple(rest), start)


def _registered(recording: Recording, sensor: Sensor, cloud: Array) -> Pose:
    try:
        return register_to_rest(sensor, cloud, recording.design.fabric)
    except InputError:
        # seen through a flat sheet, the poses to the left in front and to the right behind look the same: whose own
        # cloud does not fit either is the other one
        fits = {}
        for other in recording.sensors:
            if np.isfinite(turn := _turn(recording, other, sensor)):
                fits[bool(np.isfinite(_turn(recording, other, other))), turn] = other.name
        if not fits:
            raise
        raise InputError(
            f"reference: the cloud of {sensor.name} fits the pose of {fits[min(fits)]}; are the two swapped?"
        ) from None


def _turn(recording: Recording, sensor: Sensor, seen_by: Sensor) -> float:
    """Return by how many degrees the cloud at rest of a sensor turns the pose of one; infinite where it does not
    fit."""
    with suppress(InputError):
        pose = register_to_rest(sensor, recording.reference(seen_by), recording.design.fabric)
        return off(pose.matrix, sensor.camera_to_world)[1]
    return np.inf


def plain_frames(recording: Recording, tolerance: Tolerance) -> AlignedFrames:
    """Return the sound frames of clouds, with the poses that all of them share. Raises InputError."""
    anchored = anchor_sensors(recording, tolerance)
    views = read_views(recording, anchored, tolerance)
    if anchored.rest:
        views = _without_late(anchored, _without_swapped(anchored, views, tolerance), tolerance)
    sound = []
    for frame, mine in _by_frame(views).items():
        with tolerance.forgiving():
            if {anchored.start.sides[v.camera] for v in mine} != {"front", "back"}:
                raise InputError(
                    f"frame {frame}: no sensor left on one side; expected one in front and one at the back"
                )
            sound += mine
    if not sound:
        raise InputError(f"recording {recording.name}: no sound frame is left")
    frames = _by_frame(sound)
    poses = align([*anchored.rest, *sound], anchored.anchors, anchored.start)
    times = recording.times[[*frames]]
    return AlignedFrames(recording=recording, anchored=anchored, poses=poses, times=times, views=[*frames.values()])


def read_views(recording: Recording, anchored: Anchored, tolerance: Tolerance) -> list[SensorView]:
    """Return every frame's clouds, cleaned, without the ripple that a sensor's clouds show. Raises InputError."""
    views = []
    for camera, sensor in enumerate(anchored.sensors):
        rasters = {}
        for frame in range(len(recording.times)):
            with tolerance.forgiving():
                rasters[frame] = raster(recording.frame(sensor, frame))
        some = [*rasters.values()][:: max(len(rasters) // RIPPLE_IMAGES, 1)]
        ripple = ripple_of([each.depth for each in some], some[0].focal, some[0].pixel) if some else None
        for frame, (depth, slopes, pixel, _) in rasters.items():
            flat = depth if ripple is None else ripple.without(depth)
            views.append(SensorView(frame, camera, clean_image(flat, slopes, pixel)))
    return sorted(views, key=lambda view: (view.frame, view.camera))


def _by_frame(views: Iterable[SensorView]) -> dict[int, list[SensorView]]:
    frames: dict[int, list[SensorView]] = {}
    for view in sorted(views, key=lambda view: view.frame):
        frames.setdefault(view.frame, []).append(view)
    return frames


def _without_swapped(anchored: Anchored, views: Sequence[SensorView], tolerance: Tolerance) -> list[SensorView]:
    kept, arranged = [], anchored.start
    for frame, mine in _by_frame(views).items():
        with tolerance.forgiving():
            if disagreement(mine, arranged) > DISAGREE and (pair := swapped_pair(mine, arranged)) is not None:
                a, b = (anchored.sensors[c].name for c in pair)
                raise InputError(f"frame {frame}: the clouds of {a} and {b} look swapped")
            kept += mine
    return kept


def _without_late(anchored: Anchored, views: list[SensorView], tolerance: Tolerance) -> list[SensorView]:
    arranged = anchored.start
    worst = max((disagreement(mine, arranged) for mine in _by_frame(views).values()), default=0.0)
    shifted = shifted_sensor(views, arranged) if worst > DISAGREE / 2 else None
    if shifted is None:
        return views
    camera, lags = shifted
    first = next(frame for frame, lag in lags.items() if lag)
    lag, name = lags[first], anchored.sensors[camera].name
    line = f"sensor {name}: its frames fit the others' {abs(lag)} frames {'later' if lag > 0 else 'earlier'}"
    same = len({lag for frame, lag in lags.items() if frame >= min(lags) + abs(lag)}) == 1
    why = "; its clock differs" if same else f" from frame {first} on; was one lost or repeated?"
    tolerance.note(InputError(line + why))
    moved = [replace(v, frame=v.frame + lags[v.frame]) if v.camera == camera else v for v in views]
    latest = {(v.frame, v.camera): v for v in moved if v.frame in lags}  # of two on one frame the later counts
    return list(latest.values())


def disagreement(views: Sequence[SensorView], arranged: Arrangement) -> float:
    """Return the median distance [m] between the sensors of one frame; points without a partner count as far."""
    gaps = [arranged.gap(a, b) for a, b in combinations(views, 2)]
    return float(np.median(gaps)) if gaps else 0.0


def swapped_pair(views: Sequence[SensorView], arranged: Arrangement) -> tuple[int, int] | None:
    """Return the front and back cameras whose clouds must be exchanged for the frame to agree, if that is wrong."""
    remaining = {}
    for a, b in combinations([v.camera for v in views], 2):
        if arranged.sides[a] != arranged.sides[b]:
            exchanged = [replace(v, camera={a: b, b: a}.get(v.camera, v.camera)) for v in views]
            remaining[a, b] = disagreement(exchanged, arranged)
    best = min(remaining, key=remaining.__getitem__, default=None)
    return best if best and remaining[best] < BETTER * disagreement(views, arranged) else None


def shifted_sensor(views: Sequence[SensorView], arranged: Arrangement) -> tuple[int, dict[int, int]] | None:
    """Return the camera whose frames fit the others' some frames later (or earlier), by frame how many, if one does.

    Where no stamps are there, the motion itself tells of a cloud that was lost or stands twice: from then on a camera's
    frames fit others. The path of lags with the least distances is taken; a change of the lag costs CHANGE.
    """
    cameras = sorted({v.camera for v in views})
    by_place = {(v.frame, v.camera): v for v in views if v.frame >= 0}
    frames = sorted({frame for frame, _ in by_place})
    shifts: list[tuple[float, int, dict[int, int]]] = []
    for camera in cameras:
        cost = np.full((len(frames), len(LAGS)), UNKNOWN)
        for i, frame in enumerate(frames):
            view = by_place.get((frame, camera))
            for j, lag in enumerate(LAGS):
                others = [by_place.get((frame + lag, other)) for other in cameras if other != camera]
                gaps = [arranged.gap(view, other) for other in others if view and other]
                cost[i, j] = float(np.mean(gaps)) if gaps else UNKNOWN
        path = _cheapest(cost)
        before = float(cost[:, LAGS.index(0)].mean())
        gain = float(np.mean([cost[i, j] for i, j in enumerate(path)])) / before if before > 0 else 1.0
        lags = {frame: LAGS[j] for frame, j in zip(frames, path, strict=True)}
        if any(lags.values()) and gain < BETTER:
            shifts.append((gain, camera, lags))
    return min(shifts, key=itemgetter(0))[1:] if shifts else None


def _cheapest(cost: Array) -> list[int]:
    """Return the column of each row with the least sum, where each change of the column costs CHANGE (Viterbi)."""
    total, came = cost[0].copy(), []
    change = CHANGE * np.abs(np.subtract.outer(np.arange(cost.shape[1]), np.arange(cost.shape[1])))
    for row in cost[1:]:
        through = total[:, None] + change
        came.append(through.argmin(axis=0))
        total = through.min(axis=0) + row
    path = [int(total.argmin())]
    for back in reversed(came):
        path.append(int(back[path[-1]]))
    return path[::-1]
