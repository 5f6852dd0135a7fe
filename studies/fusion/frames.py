"""A recording's frames as they are fused, one after another, and what the report says of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.recording import Recording
from fabdesign.errors import InputError
from fabdesign.files.measurement_set import TrialData
from fabdesign.nouns.trial import RecordingTiming
from fabdesign.units import in_mm

if TYPE_CHECKING:
    from studies.fusion.input import Anchored
    from studies.fusion.joint import SensorView
    from studies.fusion.stamped import StampedFrames

Array = NDArray[np.float64]
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
    ) -> None:
        self._recording, self._anchored, self._poses = recording, anchored, list(poses)
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

    def report(
        self,
        skipped: tuple[str, ...],
        wall: float,
        stamped: "StampedFrames | None" = None,
        target: Mapping[str, float] | None = None,
    ) -> FusionReport:
        """Return what was done. target: by sensor the residual [m] of its pose by a target."""
        from studies.fusion.reference import off

        sensors = []
        for camera, sensor in enumerate(self._anchored.sensors):
            moved, turned = off(self._poses[camera], sensor.camera_to_world)
            squares = np.concatenate([np.zeros(0), *self._squares[camera]])
            residual = float(np.sqrt(squares.mean())) if len(squares) else float("nan")
            pose = self._poses[camera].tolist()
            counts = len(squares), self._dropped[camera]
            cut = None if stamped is None else stamped.cutters[camera].shares
            seen = in_mm(target[sensor.name]) if target else None
            sensors.append(SensorReport(sensor.name, pose, in_mm(moved), turned, in_mm(residual), *counts, cut, seen))
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
        )

    def data(self) -> TrialData:
        times = np.array(self.times)
        pressure = self._recording.program.at(np.maximum(times - JUST_BEFORE, 0.0))
        return TrialData(times, pressure, tuple(self.frames))

    def last(self) -> dict[str, Array]:
        """Return the last frame's clouds in the world by sensor name."""
        poses = self._frame_poses[-1]
        return {self._anchored.sensors[v.camera].name: v.placed(poses[v.camera])[0] for v in self._last}

    def draw(self, path: Path, measured: Callable[[int], Array]) -> None:
        """Draw the last frame before and after. measured: gives a camera's cloud (n, 3) m as it was measured."""
        from studies.fusion.picture import draw

        before = {}
        for view in self._last:
            sensor = self._anchored.sensors[view.camera]
            before[sensor.name] = measured(view.camera) @ sensor.camera_to_world[:3, :3].T + sensor.position
        draw(before, self.last(), path, title=f"{self._recording.name}, {self.times[-1]:.3f} s")
