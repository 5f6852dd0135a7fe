"""`fabdesign fuse`: raw clouds or depth images of several sensors become a measurement set, a trial a recording.

Every sensor is registered to the cloth at rest, all of them jointly to one another over all frames; then each frame is
thinned on a grid, face by face, and sampled. docs/lab/fuse.md has the figures.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fabdesign.clouds.recording import Convention, Recording, read_recording
from fabdesign.errors import InputError
from fabdesign.files.measurement_set import NewTrial, TrialData, write_set
from fabdesign.formats.json_file import write_json
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.output import new_folder
from fabdesign.runtime import working_time
from fabdesign.units import in_mm
from studies.fusion.input import AlignedFrames, plain_frames
from studies.fusion.joint import SensorView, align
from studies.fusion.reference import Pose, normals_of, off, point_cloud
from studies.fusion.report import FusionReport, SensorReport, blocks_of, draw
from studies.fusion.stamped import StampedFrames, stamped_frames
from studies.fusion.targets import felt_gravity, upright, with_target_poses
from studies.measured.splits import Tolerance
from studies.report.page import html_of

POINTS = 3362  # a frame, as many as 41 x 41 points on two faces
JUST_BEFORE = 1e-6  # s: a frame's set point is that of the interval it ends
KNOCKED = (np.radians(0.2), 0.001)  # rad and m that a pose may change from frame to frame
SPARE = 1.13  # grid points over points that are asked for (the paper: about 3,800 over 3,362)
SHRINK = 0.92  # of the box, where there are too few


@dataclass(frozen=True)
class FusionOptions:
    """How recordings are fused. points: a frame. per_frame: refine the poses for each frame on its own, from the shared
    ones. convention: of the clouds' axes (see read_recording). skip_bad: leave out what is unsound, also a whole
    recording among several, and list it, instead of raising."""

    points: int = POINTS
    per_frame: bool = False
    convention: Convention = "forward"
    skip_bad: bool = False
    seed: int = 0


def fuse(recording: Path | str | Recording, out: Path | str, *, force: bool = False, **given: Any) -> FusionReport:
    """Fuse a recording into the measurement set `out`: one trial of order 0. given: FusionOptions."""
    return fuse_all([recording], out, FusionOptions(**given), force=force)[0]


def fuse_all(
    recordings: Sequence[Path | str | Recording],
    out: Path | str,
    options: FusionOptions = FusionOptions(),
    *,
    force: bool = False,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> tuple[FusionReport, ...]:
    """Fuse recordings into the measurement set `out`: a trial each, role fit, its order its place among those given.
    Recordings of equal designs share one. A report on each trial.

    force: replace a set that this program made. progress is told a recording's frames done and in all. Raises
    InputError.
    """
    if options.points < 2:
        raise InputError(f"points = {options.points}; expected at least 2")
    _require_open3d()
    given = [r if isinstance(r, Recording) else read_recording(r, convention=options.convention) for r in recordings]
    if not given:
        raise InputError("fuse: no recordings; expected at least one")
    folders = [recording.folder.resolve() for recording in given]
    if (twice := next((folder for folder in folders if folders.count(folder) > 1), None)) is not None:
        raise InputError(f"{given[folders.index(twice)].folder}: is given twice; expected every recording once")
    keys, designs = _designs(given)
    reports: dict[int, FusionReport] = {}
    skipped: list[str] = []  # of recordings that are left out whole

    def trials(folder: Path) -> Iterator[NewTrial]:
        for order, recording in enumerate(given):
            try:
                fusion, report = fused_recording(recording, options, progress)
            except InputError as error:
                line = str(error) if len(given) == 1 else f"recording {recording.folder}: {error}"
                if len(given) == 1 or not options.skip_bad:
                    raise InputError(line) from None
                skipped.append(line)
                continue
            reports[order] = replace(report, order=order)
            fusion.draw(folder, "" if len(given) == 1 else f"_{order:03d}", report)
            yield NewTrial(f"{order:03d}", keys[order], order, "fit", fusion.data(), report.timing)
        if not reports:
            raise InputError(f"{given[0].folder}: no recording is left; {skipped[0]}")

    with new_folder(out, made_by="fuse", force=force, inputs=[r.folder for r in given]) as unfinished:
        names = f"fused from the recording{'s' * (len(given) > 1)} {', '.join(r.name for r in given)}"
        write_set(unfinished, designs, trials(unfinished), name=Path(out).resolve().name, description=names)
        first = min(reports)
        reports[first] = replace(reports[first], skipped=(*skipped, *reports[first].skipped))
        done = tuple(reports.values())
        write_json(unfinished / "fusion.json", done[0] if len(given) == 1 else {"trials": done})
    return done


def _require_open3d() -> None:
    try:
        import_module("open3d")
    except ImportError:
        raise InputError("fuse needs the package open3d; pip install fabdesign[clouds]") from None
    except OSError as error:
        raise InputError(
            f"open3d does not load ({error}); on Debian: apt install libx11-6 libgl1 libegl1 libusb-1.0-0"
        ) from None


def _designs(recordings: Sequence[Recording]) -> tuple[list[str], dict[str, Design]]:
    """Return each recording's key in the set's designs, and these: equal ones once, another of one name as NAME_2."""
    keys, designs = [], dict[str, Design]()
    for design in (recording.design for recording in recordings):
        names = (f"{design.name}_{number}" if number > 1 else design.name for number in count(1))
        keys.append(next(name for name in names if designs.setdefault(name, design) == design))
    return keys, designs


def fused_recording(
    recording: Recording, options: FusionOptions, progress: Callable[[int, int], None]
) -> tuple["Fusion", FusionReport]:
    """Return a fused recording. Raises InputError."""
    started, tolerance = working_time.seconds(), Tolerance(options.skip_bad)
    target = dict[str, float]()
    aligned: AlignedFrames
    if recording.depth:
        recording, target = with_target_poses(recording)
        aligned = stamped_frames(upright(recording), tolerance)
    else:
        aligned = plain_frames(recording, tolerance)
    fusion = Fusion(aligned, options)
    for done, (index, time, views) in enumerate(aligned.frames(), start=1):
        with tolerance.forgiving():
            fusion.add(index, time, views)
        progress(done, len(aligned.times))
    if not fusion.frames:
        raise InputError(f"recording {recording.name}: no sound frame is left")
    skipped = tuple(filter(None, (recording.left_out, *tolerance.skipped)))
    return fusion, fusion.report(skipped, working_time.seconds() - started, target)


class Fusion:
    """Frames as they are fused, one after another: a grid-thinned cloud for each face; and what the report says of
    them."""

    def __init__(self, aligned: AlignedFrames, options: FusionOptions) -> None:
        self._aligned, self._options = aligned, options
        self._rng = np.random.default_rng(options.seed)
        self._squares: list[list[Array]] = [[] for _ in aligned.poses]
        self._dropped = [0 for _ in aligned.poses]
        self._frame_poses: list[Sequence[Array]] = []
        self._thickness: list[float] = []
        self._last: Sequence[SensorView] = []
        self.times: list[float] = []
        self.frames: list[Array] = []

    def add(self, index: int, time: float, views: Sequence[SensorView]) -> None:
        """Fuse one frame, of a time [s]. Raises InputError."""
        points, fabric = self._options.points, self._aligned.recording.design.fabric
        start, poses = self._aligned.anchored.start, self._aligned.poses
        if self._options.per_frame:
            poses = align(views, [Pose.within(pose, *KNOCKED) for pose in poses], replace(start, poses=poses))
        placed = {v.camera: v.placed(poses[v.camera])[0] for v in views}
        faces = {side: [placed[c] for c in placed if start.sides[c] == side] for side in ("front", "back")}
        try:
            thinned = _thin(faces, points, fabric.width * fabric.height)
        except InputError as error:
            raise InputError(f"frame {index}: {error}") from None
        normals = {side: normals_of(face) for side, face in thinned.items()}
        for view in views:
            side = start.sides[view.camera]
            _, nearest = cKDTree(thinned[side]).query(placed[view.camera])
            beside = placed[view.camera] - thinned[side][nearest]
            self._squares[view.camera].append(np.einsum("ni,ni->n", beside, normals[side][nearest]) ** 2)
            self._dropped[view.camera] += view.cloud.dropped
        self._thickness.append(_thickness(thinned["front"], thinned["back"], normals["back"]))
        both = np.concatenate(list(thinned.values()))
        self.frames.append(both[self._rng.choice(len(both), points, replace=False)])
        self.times.append(time)
        self._frame_poses.append(poses)
        self._last = views

    def report(self, skipped: tuple[str, ...], wall: float, target: Mapping[str, float]) -> FusionReport:
        """Return what was done. target: by sensor the residual [m] of its pose by a target."""
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
            in_mm(aligned.anchored.start.thickness),
            skipped,
            wall,
            by_frame if self._options.per_frame else None,
            timing=aligned.timing,
            vertical_deg=None if down is None else float(np.degrees(np.arccos(np.clip(-down[1], -1.0, 1.0)))),
        )

    def data(self) -> TrialData:
        times = np.array(self.times)
        pressure = self._aligned.recording.program.at(np.maximum(times - JUST_BEFORE, 0.0))
        return TrialData(times, pressure, tuple(self.frames))

    def draw(self, folder: Path, ending: str, report: FusionReport) -> None:
        """Draw the last frame before and after, and of stamped images the page."""
        aligned, time, before, after = self._aligned, self.times[-1], {}, {}
        for view in self._last:
            sensor = aligned.anchored.sensors[view.camera]
            after[sensor.name] = view.placed(self._frame_poses[-1][view.camera])[0]
            cloud = aligned.measured(view.camera, time)
            before[sensor.name] = cloud @ sensor.camera_to_world[:3, :3].T + sensor.position
        draw(before, after, folder / f"fusion{ending}.png", title=f"{aligned.recording.name}, {time:.3f} s")
        if isinstance(aligned, StampedFrames):
            page = html_of(f"Fused: {report.recording}", blocks_of(report, after, aligned))
            (folder / f"report{ending}.html").write_text(page, encoding="utf-8")


def _thin(faces: Mapping[str, Sequence[Array]], points: int, area: float) -> dict[str, Array]:
    """Return one point a grid box (the mean of what lies in it), face by face, so that the faces never mix.

    faces: clouds (n, 3) m of every sensor; area of the cloth in m^2. At least `points` points in all; raises
    InputError where the sensors saw fewer.
    """
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


def _thickness(front: Array, back: Array, back_normals: Array) -> float:
    """Return the median distance [m] of the front face from the back face, where both were seen."""
    apart, nearest = cKDTree(back).query(front)
    over = apart < 2.0 * float(np.median(apart))
    along = np.einsum("ni,ni->n", front[over] - back[nearest[over]], back_normals[nearest[over]])
    return float(np.median(np.abs(along)))
