"""A recording's frames as they are fused, one after another: a grid-thinned cloud for each face; and what the report
says of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fabdesign.errors import InputError
from fabdesign.files.measurement_set import TrialData
from fabdesign.nouns.trial import RecordingTiming
from fabdesign.units import in_mm

if TYPE_CHECKING:
    from studies.fusion.input import AlignedFrames
    from studies.fusion.joint import SensorView

Array = NDArray[np.float64]
JUST_BEFORE = 1e-6  # s: a frame's set point is that of the interval it ends
NORMAL_RADIUS, NORMAL_NEIGHBOURS = 0.012, 30  # m
SPARE = 1.13  # grid points over points that are asked for (the paper: about 3,800 over 3,362)
SHRINK = 0.92  # of the box, where there are too few


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

    def __init__(self, aligned: "AlignedFrames", points: int, per_frame: bool, seed: int) -> None:
        self._aligned, self._points, self._per_frame = aligned, points, per_frame
        self._rng = np.random.default_rng(seed)
        self._squares: list[list[Array]] = [[] for _ in aligned.poses]
        self._dropped = [0 for _ in aligned.poses]
        self._frame_poses: list[Sequence[Array]] = []
        self._thickness: list[float] = []
        self._last: Sequence[SensorView] = []
        self.times: list[float] = []
        self.frames: list[Array] = []

    def add(self, index: int, time: float, views: "Sequence[SensorView]") -> None:
        """Fuse one frame, of a time [s]. Raises InputError."""
        from studies.fusion.joint import align_frame

        aligned, fabric = self._aligned, self._aligned.recording.design.fabric
        sides, poses = aligned.anchored.sides, aligned.poses
        if self._per_frame:
            poses = align_frame(views, aligned.anchored.arranged(poses))
        placed = {v.camera: v.placed(poses[v.camera])[0] for v in views}
        faces = {side: [placed[c] for c in placed if sides[c] == side] for side in ("front", "back")}
        try:
            thinned = _thin(faces, self._points, fabric.width * fabric.height)
        except InputError as error:
            raise InputError(f"frame {index}: {error}") from None
        normals = {side: _normals(face) for side, face in thinned.items()}
        for view in views:
            side = sides[view.camera]
            _, nearest = cKDTree(thinned[side]).query(placed[view.camera])
            off = placed[view.camera] - thinned[side][nearest]
            self._squares[view.camera].append(np.einsum("ni,ni->n", off, normals[side][nearest]) ** 2)
            self._dropped[view.camera] += view.cloud.dropped
        self._thickness.append(_thickness(thinned["front"], thinned["back"], normals["back"]))
        both = np.concatenate(list(thinned.values()))
        self.frames.append(both[self._rng.choice(len(both), self._points, replace=False)])
        self.times.append(time)
        self._frame_poses.append(poses)
        self._last = views

    def report(self, skipped: tuple[str, ...], wall: float, target: Mapping[str, float]) -> FusionReport:
        """Return what was done. target: by sensor the residual [m] of its pose by a target."""
        from studies.fusion.reference import off
        from studies.fusion.targets import felt_gravity

        aligned, sensors, by_frame = self._aligned, [], {}
        for camera, (sensor, pose) in enumerate(zip(aligned.anchored.sensors, aligned.poses, strict=True)):
            moved, turned = off(pose, sensor.camera_to_world)
            squares = np.concatenate([np.zeros(0), *self._squares[camera]])
            residual = float(np.sqrt(squares.mean())) if len(squares) else float("nan")
            cut, ripple = None, None
            if aligned.cutters:
                cutter = aligned.cutters[camera]
                cut, ripple = cutter.shares, 0.0 if cutter.ripple is None else in_mm(cutter.ripple.depth)
            seen = in_mm(target[sensor.name]) if target else None
            counts = len(squares), self._dropped[camera]
            figures = in_mm(moved), turned, in_mm(residual), *counts, cut, seen, ripple
            sensors.append(SensorReport(sensor.name, pose.tolist(), *figures))
            by_frame[sensor.name] = [poses[camera].tolist() for poses in self._frame_poses]
        down = felt_gravity([cutter.stream for cutter in aligned.cutters], aligned.poses) if aligned.cutters else None
        return FusionReport(
            aligned.recording.name,
            len(self.frames),
            tuple(sensors),
            in_mm(float(np.median(self._thickness))),
            in_mm(aligned.anchored.thickness),
            skipped,
            wall,
            by_frame if self._per_frame else None,
            timing=aligned.timing,
            vertical_deg=None if down is None else float(np.degrees(np.arccos(np.clip(-down[1], -1.0, 1.0)))),
        )

    def data(self) -> TrialData:
        times = np.array(self.times)
        pressure = self._aligned.recording.program.at(np.maximum(times - JUST_BEFORE, 0.0))
        return TrialData(times, pressure, tuple(self.frames))

    def draw(self, folder: Path, ending: str, report: FusionReport) -> None:
        """Draw the last frame before and after, and of stamped images the page."""
        from studies.fusion.report import draw, page_of
        from studies.fusion.stamped import StampedFrames

        aligned, time, before, after = self._aligned, self.times[-1], {}, {}
        for view in self._last:
            sensor = aligned.anchored.sensors[view.camera]
            after[sensor.name] = view.placed(self._frame_poses[-1][view.camera])[0]
            cloud = aligned.measured(view.camera, time)
            before[sensor.name] = cloud @ sensor.camera_to_world[:3, :3].T + sensor.position
        draw(before, after, folder / f"fusion{ending}.png", title=f"{aligned.recording.name}, {time:.3f} s")
        if isinstance(aligned, StampedFrames):
            (folder / f"report{ending}.html").write_text(page_of(report, after, aligned), encoding="utf-8")


def _thin(faces: Mapping[str, Sequence[Array]], points: int, area: float) -> dict[str, Array]:
    """Return one point a grid box (the mean of what lies in it), face by face, so that the faces never mix.

    faces: clouds (n, 3) m of every sensor; area of the cloth in m^2. At least `points` points in all; raises
    InputError where the sensors saw fewer.
    """
    from studies.fusion.reference import point_cloud

    clouds = {side: point_cloud(np.concatenate(seen)) for side, seen in faces.items()}
    seen = sum(len(cloud.points) for cloud in clouds.values())
    if seen < points:
        raise InputError(f"{points} points asked for; the sensors saw {seen} of the cloth")
    box = (2.0 * area / (SPARE * points)) ** 0.5
    while True:
        thinned = {side: cloud.voxel_down_sample(box) for side, cloud in clouds.items()}
        if sum(len(cloud.points) for cloud in thinned.values()) >= points:
            return {side: np.asarray(cloud.points) for side, cloud in thinned.items()}
        box *= SHRINK


def _normals(face: Array) -> Array:
    """Return (n, 3) unit normals of a face's points, of either sign."""
    import open3d as o3d

    from studies.fusion.reference import point_cloud

    cloud = point_cloud(face)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(NORMAL_RADIUS, NORMAL_NEIGHBOURS))
    return np.asarray(cloud.normals)


def _thickness(front: Array, back: Array, back_normals: Array) -> float:
    """Return the median distance [m] of the front face from the back face, where both were seen."""
    apart, nearest = cKDTree(back).query(front)
    over = apart < 2.0 * float(np.median(apart))
    along = np.einsum("ni,ni->n", front[over] - back[nearest[over]], back_normals[nearest[over]])
    return float(np.median(np.abs(along)))
