"""Recordings as a laboratory has them, from virtual depth cameras through the RealSense SDK's own recorder: what
becomes of known faces, clocks and poses. Writes its part of docs/lab/fuse.md.

    python -m benchmarks.recordings FOLDER --sdk SDK_2_56 --sdk SDK_2_59 [--page]

An SDK is a folder named realsense-VERSION in which pyrealsense2 was installed (`pip install --target`): 2.56 writes
`.bag`, 2.59 `.db3`.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import write_part
from benchmarks.recorded_rig import DURATION, RecordedRig, make_rig, rms_to_faces
from fabdesign.clouds.recording import read_recording
from fabdesign.files.measurement_set import NewTrial, TrialData, read_set, write_set
from fabdesign.nouns.array import Array
from studies.fusion.cleaning import ImageFilter, clean_image
from studies.fusion.fuse import fuse
from studies.fusion.moving import Clock
from studies.fusion.reference import moved, off
from studies.fusion.ripple import ripple_of
from studies.fusion.stamped import StampedFrames, stamped_frames
from studies.measured.splits import Tolerance
from studies.rig.cameras import measure
from studies.rig.specimen import Sensing

PAGE = Path(__file__).parents[1] / "docs" / "lab" / "fuse.md"


@dataclass(frozen=True)
class Outcome:
    """What one kind of file gave, mm, ms and CPU seconds."""

    ending: str
    frames: int
    cpu_a_frame: float
    rms_mm: float
    clocks_ms: float  # worst camera
    pressure_ms: float
    drifts_ppm: float
    poses: tuple[float, float]  # mm and degrees, worst camera
    lost: tuple[int, int]  # found, made


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sdk", type=Path, action="append", default=[])
    parser.add_argument("--page", action="store_true")
    parser.add_argument("--no-calibration", action="store_true")
    parser.add_argument("--seed", type=int, default=5, help="of the motion, the poses and the clocks")
    given = parser.parse_args(arguments)
    given.folder.mkdir(parents=True, exist_ok=True)
    rig = make_rig(given.folder, seed=given.seed)
    outcomes = []
    for sdk in given.sdk:
        outcomes.append(_outcome(rig, given.folder, sdk))
        print(outcomes[-1], flush=True)
    last = given.folder / f"recording{outcomes[-1].ending}" if outcomes else given.folder / "recording.npz"
    if not outcomes:
        rig.write(last, ".npz")
    mistakes = _mistakes(rig, last)
    filters = _filters(rig)
    factors = {} if given.no_calibration else _factors(rig, given.folder, given.folder / f"set{last.suffix}")
    lines = list(_lines(outcomes, mistakes, filters, factors))
    print("\n".join(lines))
    if given.page:
        write_part(PAGE, "recordings", "\n".join(lines))


def _outcome(rig: RecordedRig, folder: Path, sdk: Path) -> Outcome:
    """Record by an SDK, fuse, and compare with what is true."""
    ending = ".bag" if "2.56" in sdk.name else ".db3"
    recording, out = folder / f"recording{ending}", folder / f"set{ending}"
    if not (recording / "recording.toml").is_file():
        script = Path(__file__).parents[1] / "scripts" / "write_realsense.py"
        rig.write(recording, ending)
        for name in rig.names:
            files = [str(recording / f"{name}{suffix}") for suffix in (".npz", ending)]
            subprocess.run([sys.executable, script, *files], check=True, env=os.environ | {"PYTHONPATH": f"{sdk}"})
            Path(files[0]).unlink()
    started = time.process_time()
    report = fuse(recording, out, force=True)
    spent = time.process_time() - started
    data = read_set(out).trials[0].load()
    assert report.timing is not None
    timing = report.timing
    off_clocks = [1e3 * (timing.sensors[n].offset - rig.ahead(n)) for n in rig.names]
    drifts = [1e6 * (timing.sensors[n].drift - rig.drifts[n] + rig.drifts[rig.names[0]]) for n in rig.names]
    begins = timing.pressure - (0.0 - rig.true[rig.names[0]][0])
    poses = [off(np.array(s.camera_to_world), rig.poses[s.name]) for s in report.sensors]
    worst = max(1e3 * d for d, _ in poses), max(angle for _, angle in poses)
    lost = sum(t.lost for t in timing.sensors.values()), sum(rig.lost.values())
    return Outcome(
        ending,
        report.frames,
        spent / report.frames,
        1e3 * rms_to_faces(rig, data.time, data.frames),
        max(map(abs, off_clocks)),
        1e3 * begins,
        max(map(abs, drifts)),
        worst,
        lost,
    )


def _fused_rms(rig: RecordedRig, stamped: StampedFrames) -> float:
    """Return the distance [mm] to the true faces of all views as they are placed, without thinning."""
    times, clouds = [], []
    for _, at, views in islice(stamped.frames(), 0, None, 4):
        times.append(at)
        clouds.append(np.concatenate([view.placed(stamped.poses[view.camera], 3)[0] for view in views]))
    return 1e3 * rms_to_faces(rig, np.array(times), clouds)


def _mistakes(rig: RecordedRig, recording: Path) -> dict[str, float]:
    """Return what one camera's wrong pose or clock costs, uncorrected, and poses as they were given."""
    stamped = stamped_frames(read_recording(recording), Tolerance(True))
    turn, shift = np.array([0, np.radians(1.0), 0, 0, 0, 0]), np.array([0, 0, 0, 0, 0, 0.005])
    camera = 1
    costs = {"none": _fused_rms(rig, stamped)}
    for name, small in (("one camera turned by 1 degree", turn), ("one camera shifted by 5 mm", shift)):
        poses = [moved(p, small) if k == camera else p for k, p in enumerate(stamped.poses)]
        costs[name] = _fused_rms(rig, replace(stamped, poses=poses))
    clocks = [Clock(c.offset + 0.02 * (k == camera), c.drift, c.middle) for k, c in enumerate(stamped.timed.clocks)]
    costs["one clock late by 20 ms"] = _fused_rms(rig, replace(stamped, timed=replace(stamped.timed, clocks=clocks)))
    nominal = [sensor.camera_to_world for sensor in stamped.anchored.sensors]
    costs["no board, no cloth at rest: nominal poses (10 mm, 2 degrees)"] = _fused_rms(
        rig, replace(stamped, poses=nominal)
    )
    return costs


FILTERS = {  # and whether ripple is taken off
    "none": (ImageFilter(smooth=False, flying=False), False),
    "flying pixels go": (ImageFilter(smooth=False), False),
    "flying pixels go, local planes": (ImageFilter(), False),
    "ripple is taken off, flying pixels go, local planes": (ImageFilter(), True),
}
RIPPLES = (0.0, 0.05, 0.26, 0.53)  # pixels of disparity


def _filters(rig: RecordedRig) -> dict[str, list[float]]:
    """Return the distance [mm] of single images' points to the true faces by true poses: by filter, of each ripple."""
    costs: dict[str, list[float]] = {name: [] for name in FILTERS}
    times = np.array([-0.2, 0.1, 0.5, 0.9])
    for ripple in RIPPLES:
        rng = np.random.default_rng(3)
        camera = replace(rig.camera, ripple=ripple)
        focal, pixel, slopes = camera.optics.focal[0], 0.62 / camera.optics.focal[0], camera.optics.slopes
        clouds: dict[str, list[Array]] = {name: [] for name in FILTERS}
        for pose in rig.poses.values():
            images = [camera.image(rig.scene, rig.shape(t), pose, rng) * camera.unit for t in times]
            seen = np.any(images, axis=0)
            part = slice(*np.flatnonzero(seen.any(axis=1))[[0, -1]]), slice(*np.flatnonzero(seen.any(axis=0))[[0, -1]])
            shown = [np.ascontiguousarray(image[part]) for image in images]
            ripple_seen = ripple_of(shown, focal, pixel)
            for name, (filters, flat) in FILTERS.items():
                for image in shown if not flat or ripple_seen is None else map(ripple_seen.without, shown):
                    points = clean_image(image, np.ascontiguousarray(slopes[part]), pixel, filters=filters).points
                    clouds[name].append(points @ pose[:3, :3].T + pose[:3, 3])
        for name, each in clouds.items():
            costs[name].append(1e3 * rms_to_faces(rig, [*times] * len(rig.poses), each))
    return costs


def _factors(rig: RecordedRig, folder: Path, fused: Path) -> dict[str, dict[str, Any]]:
    """Return the factors calibrated on the fused set and on perfect clouds at the same times."""
    from fabdesign import calibrate

    data = read_set(fused).trials[0].load()
    rng = np.random.default_rng(0)
    frames = tuple(
        measure(rig.scene, rig.shape(t), Sensing(points=3362, noise=0.0, strays=0.0), rng) for t in data.time
    )
    perfect = TrialData(data.time, data.pressure, frames)
    design = rig.task.design
    shutil.rmtree(folder / "perfect", ignore_errors=True)
    write_set(
        folder / "perfect",
        {design.name: design},
        [NewTrial("000", design.name, 0, "fit", perfect)],
        name="p",
    )
    factors: dict[str, dict[str, Any]] = {}
    for name, measured in (("perfect", folder / "perfect"), ("fused", fused)):
        kept = folder / f"factors_{name}.json"
        if not kept.is_file():
            parameters: Mapping[str, Any] = calibrate(measured, grid=21).model.parameters
            kept.write_text(
                json.dumps(
                    {k: [p.factor, *map(float, p.interval90 or (np.nan, np.nan))] for k, p in parameters.items()}
                )
            )
        factors[name] = json.loads(kept.read_text())
    return factors


def _lines(
    outcomes: Sequence[Outcome],
    mistakes: Mapping[str, float],
    filters: Mapping[str, Sequence[float]],
    factors: Mapping[str, Mapping[str, Any]],
) -> Any:
    yield "\n## Recordings of the RealSense SDK (synthetic rig, `make bench-recordings`)\n"
    yield (
        "Four virtual D435i (848 x 480, 30 Hz, depth in mm, noise of 0.04 and ripple of 0.05 pixels of disparity: 0.8 "
        "and 1 mm at 0.65 m, the ripple's period 2.8 % of the depth; 3 % holes, flying pixels), "
        f"{DURATION:g} s, clocks apart by up to 40 ms and 200 ppm, 1 % of the images lost, nominal poses off by up to "
        "10 mm and 2 degrees, written by the SDK's software device and recorder.\n"
    )
    yield "| file | frames | RMS, mm | clocks, ms | pressure's 0, ms | drift, ppm | poses | lost | CPU s a frame |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for o in outcomes:
        yield (
            f"| `{o.ending}` | {o.frames} | {o.rms_mm:.2f} | {o.clocks_ms:.2f} | {o.pressure_ms:+.1f} | "
            f"{o.drifts_ppm:.0f} | {o.poses[0]:.2f} mm, {o.poses[1]:.3f} deg | {o.lost[0]} of {o.lost[1]} | "
            f"{o.cpu_a_frame:.2f} |"
        )
    yield (
        "\nRMS is of the set's points to the true faces at the set's times. Required: 0.8 mm, clocks 3 ms, all lost "
        "images, 0.2 CPU s a frame (imports and the page are in it). Columns hold the worst camera.\n"
    )
    yield "| mistake, uncorrected | RMS of all views to the true faces, mm |\n|---|---|"
    for name, cost in mistakes.items():
        yield f"| {name} | {cost:.2f} |"
    yield (
        "\nRMS of single images' points to the true faces, mm, by the ripple's amplitude. The default, 0.05 pixels, is "
        "0.14 % of the depth at 0.6 m. Taken off is what each camera's four images show of it.\n"
    )
    yield f"| filter | {' | '.join(f'{r:g} pixels, {2.82 * r:.2g} %' for r in RIPPLES)} |"
    yield "|---" * (1 + len(RIPPLES)) + "|"
    for name, row in filters.items():
        yield f"| {name} | {' | '.join(f'{cost:.2f}' for cost in row)} |"
    if factors:
        yield "\n| factor | perfect clouds, 90 % | fused, 90 % |\n|---|---|---|"
        for name, (value, low, high) in factors["perfect"].items():
            other = factors["fused"][name]
            fused = f"{other[0]:.3f} ({other[1]:.3f} to {other[2]:.3f})"
            yield f"| {name} | {value:.3f} ({low:.3f} to {high:.3f}) | {fused} |"


if __name__ == "__main__":
    main()
