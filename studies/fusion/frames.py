"""A recording's frames as they are fused, one after another, and what the report says of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fabdesign.clouds.recording import Recording
from fabdesign.errors import InputError
from fabdesign.files.measurement_set import TrialData
from fabdesign.nouns.array import Array
from fabdesign.nouns.trial import RecordingTiming
from fabdesign.units import in_mm

if TYPE_CHECKING:
    from studies.fusion.input import Anchored
    from studies.fusion.joint import SensorView
    from studies.fusion.stamped import StampedFrames

JUST_BEFORE = 1e-6  # s: a frame's set point is that of the interval it ends


@dataclass(frozen=True)
class SensorReport:
    name: str
    camera_to_world: list[list[float]]  # m
    moved_mm: float  # from the nominal pose
    turned_deg: float
    residual_mm: float  # root mean square distance of its cleaned points to the fused face
    points: int  # cleaned, over all frames
    dropped: int  # strays, flying pixels and edge ribbons
    cut: Mapping[str, float] | None = None  # of depth images: by rule the share of pixels that is not the cloth
    target_mm: float | None = None  # root mean square distance of the target's places to the other cameras' ones
    ripple_mm: float | None = None  # of depth images: amplitude that was taken off, at the cloth's middle


@dataclass(frozen=True)
class FusionReport:
    """A report of what was done; in SET/fusion.json, with the picture SET/fusion.png (of several, fusion_ORDER.png)."""

    recording: str
    frames: int
    sensors: tuple[SensorReport, ...]
    thickness_mm: float  # between the fused faces: median over points and frames
    declared_thickness_mm: float
    skipped: tuple[str, ...]
    wall_s: float
    frame_poses: dict[str, list[list[list[float]]]] | None = None  # by sensor, where they were asked for frame by frame
    order: int = 0  # of its trial
    timing: RecordingTiming | None = None  # of cameras that stamp their images
    vertical_deg: float | None = None  # from the world's -y to gravity, where cameras feel it


class Fusion:
    """Frames as they are fused, and what the report says of them."""

    def __init__(
        self,
        recording: Recording,
        anchored: "Anchored",
        poses: Sequence[Array],
        points: int,
        per_frame: bool,
        rng: np.random.Generator,
        stamped: "StampedFrames | None" = None,
    ) -> None:
        self._recording, self._anchored, self._poses, self._stamped = recording, anchored, list(poses), stamped
        self._points, self._per_frame, self._rng = points, per_frame, rng
        cameras = range(len(anchored.sensors))
        self._squares: list[list[Array]] = [[] for _ in cameras]
        self._dropped = [0 for _ in cameras]
        self._frame_poses: list[list[Array]] = []
        self._thickness: list[float] = []
        self._last: list[SensorView] = []
        self.times: list[float] = []
        self.frames: list[Array] = []

    def add(self, index: int, time: float, views: "list[SensorView]") -> None:
        """Fuse one frame, of a time [s]. Raises InputError."""
        from studies.fusion import surface
        from studies.fusion.joint import align_frame

        fabric, sides = self._recording.design.fabric, self._anchored.sides
        poses = align_frame(views, self._poses, sides, fabric.thickness) if self._per_frame else self._poses
        placed = {v.camera: v.placed(poses[v.camera])[0] for v in views}
        faces = {side: [placed[c] for c in placed if sides[c] == side] for side in ("front", "back")}
        try:
            thinned = surface.thin(faces, self._points, fabric.width * fabric.height)
        except InputError as error:
            raise InputError(f"frame {index}: {error}") from None
        normals = {side: surface.normals(face) for side, face in thinned.items()}
        for view in views:
            side = sides[view.camera]
            self._squares[view.camera].append(surface.distances(placed[view.camera], thinned[side], normals[side]) ** 2)
            self._dropped[view.camera] += view.cloud.dropped
        self._thickness.append(surface.thickness(thinned["front"], thinned["back"], normals["back"]))
        both = np.concatenate(list(thinned.values()))
        self.frames.append(both[self._rng.choice(len(both), self._points, replace=False)])
        self.times.append(time)
        self._frame_poses.append(poses)
        self._last = views

    def report(self, skipped: tuple[str, ...], wall: float, target: Mapping[str, float]) -> FusionReport:
        """Return what was done. target: by sensor the residual [m] of its pose by a target."""
        from studies.fusion.reference import off
        from studies.fusion.targets import felt_gravity

        sensors, stamped = [], self._stamped
        for camera, sensor in enumerate(self._anchored.sensors):
            moved, turned = off(self._poses[camera], sensor.camera_to_world)
            squares = np.concatenate([np.zeros(0), *self._squares[camera]])
            residual = float(np.sqrt(squares.mean())) if len(squares) else float("nan")
            pose = self._poses[camera].tolist()
            counts = len(squares), self._dropped[camera]
            cut, ripple = None, None
            if stamped is not None:
                cutter = stamped.cutters[camera]
                cut, ripple = cutter.shares, 0.0 if cutter.ripple is None else in_mm(cutter.ripple.depth)
            seen = in_mm(target[sensor.name]) if target else None
            sensors.append(
                SensorReport(sensor.name, pose, in_mm(moved), turned, in_mm(residual), *counts, cut, seen, ripple)
            )
        down = None
        if stamped is not None:
            down = felt_gravity([cutter.stream for cutter in stamped.cutters], self._poses)
        by_frame = None
        if self._per_frame:
            names = [s.name for s in self._anchored.sensors]
            by_frame = {name: [poses[c].tolist() for poses in self._frame_poses] for c, name in enumerate(names)}
        return FusionReport(
            self._recording.name,
            len(self.frames),
            tuple(sensors),
            in_mm(float(np.median(self._thickness))),
            in_mm(self._recording.design.fabric.thickness),
            skipped,
            wall,
            by_frame,
            timing=None if stamped is None else stamped.timing,
            vertical_deg=None if down is None else float(np.degrees(np.arccos(np.clip(-down[1], -1.0, 1.0)))),
        )

    def data(self) -> TrialData:
        times = np.array(self.times)
        pressure = self._recording.program.at(np.maximum(times - JUST_BEFORE, 0.0))
        return TrialData(times, pressure, tuple(self.frames))

    def last(self) -> dict[str, Array]:
        """Return the last frame's clouds in the world by sensor name."""
        poses = self._frame_poses[-1]
        return {self._anchored.sensors[v.camera].name: v.placed(poses[v.camera])[0] for v in self._last}

    def draw(self, folder: Path, ending: str, report: FusionReport) -> None:
        """Draw the last frame before and after, and of stamped images the page."""
        from studies.fusion.report import draw, write_report

        before, after, time = {}, self.last(), self.times[-1]
        for view in self._last:
            sensor = self._anchored.sensors[view.camera]
            if self._stamped is None:
                cloud = self._recording.frame(sensor, int(np.searchsorted(self._recording.times, time)))
            else:
                cutter = self._stamped.cutters[view.camera]
                cloud = cutter.cloud(cutter.depth(self._stamped.number(view.camera, time)))
            before[sensor.name] = cloud @ sensor.camera_to_world[:3, :3].T + sensor.position
        draw(before, after, folder / f"fusion{ending}.png", title=f"{self._recording.name}, {time:.3f} s")
        if self._stamped is not None:
            write_report(folder / f"report{ending}.html", report, after, self._stamped)
