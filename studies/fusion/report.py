"""The report of a fusion; its picture, one frame before and after; and the page of a recording of stamped images: views
with what was cut, views on the fused cloth, timings, what was left out."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fabdesign.nouns.array import Array
from fabdesign.nouns.trial import RecordingTiming
from fabdesign.units import in_mm
from studies.fusion.stamped import StampedFrames
from studies.report.page import Block, Picture, TableBlock, Text, Title

AROUND = 60  # pixels
SLICE = 0.008  # m, half the width of a slice in the picture


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


def blocks_of(report: FusionReport, last: Mapping[str, Array], stamped: StampedFrames) -> Iterator[Block]:
    """Yield the blocks of the page. last: the last frame's clouds in the world, by sensor."""
    timing = stamped.timing
    yield Title(f"{report.recording}: {report.frames} frames of {len(report.sensors)} cameras", 1)
    worst = max(sensor.residual_mm for sensor in report.sensors)
    yield Text(
        f"The views lie within {worst:.2f} mm RMS of the fused faces, which are {report.thickness_mm:.2f} mm apart "
        f"(declared {report.declared_thickness_mm:.2f} mm).",
        "verdict",
    )
    yield Title("Views")
    yield Text("What was measured (grey) and what was taken for the cloth (coloured by depth, mm), middle frame.")
    yield Picture(_views(stamped))
    rules = sorted({rule for sensor in report.sensors for rule in sensor.cut or ()})
    yield TableBlock(
        ["sensor", "points kept", "dropped as flying", *(f"cut by {rule} %" for rule in rules), "RMS to the face, mm"],
        [
            [s.name, s.points, s.dropped, *(100 * (s.cut or {}).get(rule, 0.0) for rule in rules), s.residual_mm]
            for s in report.sensors
        ],
    )
    yield Title("On the fused cloth")
    yield Text("Slices of the last frame: each camera's points, placed by its pose.")
    yield Picture(_slices(last))
    yield TableBlock(
        ["sensor", "moved from nominal, mm", "turned, degrees", "target, mm", "depth ripple taken off, mm"],
        [
            [s.name, s.moved_mm, s.turned_deg, "none" if s.target_mm is None else s.target_mm, s.ripple_mm or "none"]
            for s in report.sensors
        ],
    )
    if report.vertical_deg is not None:
        yield Text(f"Gravity, as the cameras feel it, is {report.vertical_deg:.1f} degrees from the world's -y.")
    yield Title("Time")
    yield Picture(_timeline(stamped))
    yield TableBlock(
        ["sensor", "clock ahead, ms", "known to, ms", "drift, ppm", "images", "lost", "repeated", "late", "unpaired"],
        [
            [name, 1e3 * t.offset, 1e3 * t.known, 1e6 * t.drift, t.images, t.lost, t.repeated, t.late, t.unpaired]
            for name, t in timing.sensors.items()
        ],
    )
    guessed = [name for name, t in timing.sensors.items() if not t.estimated]
    if guessed:
        yield Text(f"The cloth moves too little to say the clock of {', '.join(guessed)}: taken as stamped.", "note")
    how = f"by {timing.steps} steps, to {1e3 * timing.pressure_known:.1f} ms" if timing.steps else "as given"
    yield Text(f"The pressure's log begins {timing.pressure:.4f} s after the first camera's first image, {how}.")
    yield Title("Left out")
    yield Text(f"{timing.left_out} frames that a side has no image for.")
    for line in report.skipped:
        yield Text(line, "note")


def _views(stamped: StampedFrames) -> Figure:
    count = len(stamped.cutters)
    figure = Figure(figsize=(3.2 * count, 3.4), layout="constrained")
    time = float(stamped.times[len(stamped.times) // 2])
    for column, cutter in enumerate(stamped.cutters):
        axes = figure.add_subplot(1, count, column + 1)
        number = stamped.number(column, time)
        raw = cutter.stream.depth(number)
        cloth = np.zeros(raw.shape)
        cloth[cutter.part] = cutter.depth(number)
        axes.imshow(np.where(raw > 0, 0.75, 1.0), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        axes.imshow(np.where(cloth > 0, in_mm(cloth), np.nan), cmap="viridis", interpolation="nearest")
        rows, columns = np.nonzero(cloth)
        if len(rows):  # with what is around it
            axes.set_xlim(columns.min() - AROUND, columns.max() + AROUND)
            axes.set_ylim(rows.max() + AROUND, rows.min() - AROUND)
        axes.set_title(stamped.anchored.sensors[column].name, fontsize="small")
        axes.set_axis_off()
    return figure


def _slices(last: Mapping[str, Array]) -> Figure:
    figure = Figure(figsize=(12, 3.6), layout="constrained")
    heights = np.quantile(np.concatenate([cloud[:, 1] for cloud in last.values()]), [0.85, 0.5, 0.15])
    for axes, height in zip(figure.subplots(1, len(heights)), heights, strict=True):
        _scatter(axes, _sliced(last, height, 0.003), (0, 2), title=f"y = {in_mm(float(height)):.0f} mm")
        axes.set_aspect("equal")
    axes.legend(fontsize="x-small")
    return figure


def _timeline(stamped: StampedFrames) -> Figure:
    figure = Figure(figsize=(12, 4.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for k, views in enumerate(stamped.timed.views):
        times = stamped.timed.times[k] - stamped.offset
        above.plot(times, in_mm(np.array([view.mean_speed for view in views])), label=stamped.anchored.sensors[k].name)
        below.plot(times, np.full(len(times), k), "|", color=f"C{k}")
        lost: Any = stamped.timed.clocks[k].times(np.array(stamped.cutters[k].odd.lost)) - stamped.offset
        below.plot(lost, np.full(len(lost), k), "x", color="red")
    for time in stamped.recording.program.time[:50]:
        above.axvline(float(time), color="grey", linewidth=0.6)
    above.set_ylabel("mean speed [mm/s]")
    above.legend(fontsize="x-small")
    below.set_yticks(range(len(stamped.cutters)), [s.name for s in stamped.anchored.sensors])
    below.set_xlabel("time after the pressure's 0 [s]; a red cross is a lost image, a grey line a row of the pressures")
    return figure


def draw(before: Mapping[str, Array], after: Mapping[str, Array], path: Path, *, title: str) -> None:
    """Draw clouds (n, 3) m by sensor name, placed by the nominal and by the registered poses, as a PNG."""
    figure = Figure(figsize=(12, 9), layout="constrained")
    axes = figure.subplots(2, 2)
    middle = float(np.median(np.concatenate(list(after.values()))[:, 1]))
    for column, (name, clouds) in enumerate((("before: nominal poses", before), ("after: registered, cleaned", after))):
        _scatter(axes[0, column], clouds, (0, 1), title=f"{name}, from the front")
        slice_at = f"slice at y = {in_mm(middle):.0f} mm"
        _scatter(axes[1, column], _sliced(clouds, middle, SLICE), (0, 2), title=f"{name}, {slice_at}")
    limits = [in_mm(np.concatenate(list(before.values()))[:, k]) for k in range(3)]
    for column in range(2):
        for row, k in ((0, 1), (1, 2)):
            axes[row, column].set_xlim(*np.percentile(limits[0], [0.1, 99.9]) + [-10, 10])
            axes[row, column].set_ylim(*np.percentile(limits[k], [0.5, 99.5]) + [-10, 10])
    axes[0, 0].legend(markerscale=5, fontsize="small")
    figure.suptitle(title)
    figure.savefig(path, dpi=110, format="png")


def _sliced(clouds: Mapping[str, Array], height: float, half: float) -> dict[str, Array]:
    return {name: cloud[np.abs(cloud[:, 1] - height) < half] for name, cloud in clouds.items()}


def _scatter(axes: Axes, clouds: Mapping[str, Array], axis: tuple[int, int], *, title: str) -> None:
    for name, cloud in clouds.items():
        axes.plot(in_mm(cloud[:, axis[0]]), in_mm(cloud[:, axis[1]]), ".", markersize=2, label=name)
    axes.set_title(title)
    axes.set_xlabel(f"{'xyz'[axis[0]]} [mm]")
    axes.set_ylabel(f"{'xyz'[axis[1]]} [mm]")
