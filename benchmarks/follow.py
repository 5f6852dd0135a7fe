"""Does a cloth follow? Twelve motions made by programs that are not used, and a specimen that is not the model.

    python -m benchmarks.follow FOLDER             # all of them; those in FOLDER/results.jsonl are not done again
    python -m benchmarks.follow FOLDER steps_0     # some of them; device_0, device_1: on the virtual rig
    python -m benchmarks.follow FOLDER --page      # writes its part of docs/lab/follow.md besides

Motions are the simulator's own with the noise of a depth sensor, on four layouts, two of them not square: steps, ramps
and waves up to 2 Hz, of 1.5 and 3 s. `device`: the wanted motion is one of the virtual rig (another engine) with lag,
droop and hysteresis, which is then run with the program of the data sheet, with that of a model that was calibrated on
two other motions of it, and after each of three repetitions. With `cma` installed and --cma, CMA-ES searches for five
times as many CPU seconds, in a grid of set points between which pressures are linear.
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import ROOT, commit, processor, write_part
from benchmarks.trace_sets import Rig, measure
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model, write_model
from fabdesign.files.trial_file import TrialData, write_trial
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.array import Array
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Model
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.nouns.trial import Trial
from fabdesign.output import write_text
from fabdesign.study_files.follow_file import FollowStudy, MotionScatter, MovingTarget
from optimize.fit.free_parameters import fit_vector
from sim import Simulator
from studies.calibration.calibrate import CalibrationOptions, calibrate_sets
from studies.follow.programs import regulator_of
from studies.follow.result import FollowResult
from studies.follow.run import QUICK, run_follow
from studies.follow.wanted import wanted_of

PAGE = ROOT / "docs" / "lab" / "follow.md"
CYCLE, HIGHEST, NOISE, POINTS = 0.05, 280e3, 3e-4, 1500  # s; Pa, of hidden programs; m; of a frame
LAYOUTS = ("basic", 0.2, 0.2), ("cross", 0.2, 0.2), ("side", 0.24, 0.16), ("vertical", 0.16, 0.24)
KINDS = "steps", "ramps", "waves"
CHANNELS, GRID = 4, 21
FEWER, TIMES, BATCH = 0.1, 5.0, 32  # s between CMA-ES's set points; of our time; motions of a generation
DEVICE = {"filling_lag": {"fill": 0.08, "empty": 0.16}, "supply_droop": {"share": 0.03}, "braid_hysteresis": {}}
FIXED = "shear", "areal_density"  # that two motions say little of


@dataclass(frozen=True)
class Motion:
    """One that is to be followed."""

    kind: str
    number: int

    @property
    def name(self) -> str:
        return f"{self.kind}_{self.number}"

    @property
    def seconds(self) -> float:
        return 3.0 if (self.number + KINDS.index(self.kind)) % 2 else 1.5

    @property
    def design(self) -> Design:
        layout, width, height = LAYOUTS[self.number]
        return build(layout, muscles=CHANNELS, width=width, height=height)

    def program(self, channels: int = CHANNELS) -> Array:
        """The hidden set points (cycles, channels) Pa."""
        rng = np.random.default_rng([7, KINDS.index(self.kind), self.number])
        times = CYCLE * np.arange(round(self.seconds / CYCLE))
        if self.kind == "steps":
            levels = rng.uniform(0, HIGHEST, (int(np.ceil(self.seconds / 0.4)), channels))
            return np.asarray(levels[(times / 0.4 + 1e-9).astype(int)])
        if self.kind == "ramps":
            knots = np.append(np.arange(0, self.seconds, 0.5), self.seconds)
            values = rng.uniform(0, HIGHEST, (len(knots), channels))
            return np.stack([np.interp(times, knots, column) for column in values.T], axis=1)
        rate, phase = rng.uniform(0.4, 2.0, channels), rng.uniform(0, 2 * np.pi, channels)
        return np.asarray(HIGHEST / 2 * (1 + np.sin(2 * np.pi * np.outer(times, rate) + phase)))


MOTIONS = [Motion(kind, number) for number in range(len(LAYOUTS)) for kind in KINDS]


def study_of(motion: Motion, folder: Path, design: Design, model: Model | None = None) -> FollowStudy:
    """The study of a motion that is simulated here, with noise, and written as a trial."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{motion.name}.npz"
    target = MovingTarget(file)
    study = FollowStudy(motion.name, design, target, model, scatter=MotionScatter(copies=0), points_per_side=GRID)
    if not file.is_file():
        rng, times = np.random.default_rng(motion.number), np.arange(1, round(30 * motion.seconds) + 1) / 30
        program = regulator_of(study).program(motion.program(design.channels))
        [points] = Simulator(GRID).motions([Case(design, program)], [times])
        clouds = [Surface.of_faces(frame).sample(POINTS, rng)[0] for frame in points]
        noisy = tuple(cloud + NOISE * rng.standard_normal(cloud.shape) for cloud in clouds)
        write_trial(TrialData(times, np.zeros((len(times), design.channels)), noisy), file)
    return study


def followed(motion: Motion, folder: Path) -> dict[str, Any]:
    """Follow it, and say how near. mm, s."""
    study = study_of(motion, folder, motion.design)
    [truth] = Simulator(GRID).motions(
        [Case(study.design, regulator_of(study).program(motion.program()))], [wanted_of(study).times]
    )
    floor = rms(study, truth)
    first = Watch()
    result = run_follow(study, folder / motion.name, force=True, progress=first.heard)
    error = rms(study, result.motion)
    return {
        "motion": motion.name, "seconds": motion.seconds, "floor": floor, "error": error, "ratio": error / floor,
        "from_rest": 1e3 * result.begun, "wall": first.wall(), "cpu": first.cpu(),
        "first": first.first, "first_cpu": first.first_cpu, "first_error": first.error or error,
    }  # fmt: skip


def rms(study: FollowStudy, motion: NDArray[Any]) -> float:
    """mm, of the mean over instants of the target's points' RMS distance."""
    wanted = wanted_of(study)
    each = [
        np.sqrt(np.square(Surface.of_faces(frame).distance(target.points)).mean())
        for target, frame in zip(wanted.targets, motion, strict=True)
    ]
    return 1e3 * float(np.mean(each))


class Watch:
    """Seconds of a run. first: until its first pass was done, whose error [mm] the next one says."""

    def __init__(self) -> None:
        self._begun, self._cpu = time.monotonic(), time.process_time()
        self.first = self.first_cpu = np.nan
        self.error: float | None = None

    def heard(self, line: str, share: float | None) -> None:
        if share == 1.0 and np.isnan(self.first):
            self.first, self.first_cpu = self.wall(), self.cpu()
        elif self.error is None and not np.isnan(self.first) and "mm; windows" in line:
            self.error = float(line.split()[0])

    def wall(self) -> float:
        return time.monotonic() - self._begun

    def cpu(self) -> float:
        return time.process_time() - self._cpu


def by_cma(motion: Motion, folder: Path, seconds: float) -> float:
    """mm, what CMA-ES (Hansen 2016) comes to in so many CPU seconds, on the same quick simulator."""
    import cma

    study = study_of(motion, folder, motion.design)
    wanted, regulator = wanted_of(study), regulator_of(study)
    cycles = round(motion.seconds / CYCLE)
    knots = np.arange(0.0, motion.seconds + FEWER / 2, FEWER)
    at = CYCLE * np.arange(cycles)

    def program(x: Array) -> Array:
        rows = x.reshape(len(knots), regulator.channels) * regulator.highest
        return regulator.kept(np.stack([np.interp(at, knots, column) for column in rows.T], axis=1))

    size = len(knots) * regulator.channels
    options = {"bounds": [0, 1], "popsize": BATCH, "seed": 1, "verbose": -9}
    search = cma.CMAEvolutionStrategy(np.full(size, 0.4), 0.2, options)
    begun, best, least = time.process_time(), np.full(size, 0.4), np.inf
    while time.process_time() - begun < seconds and not search.stop():
        asked = [np.asarray(x) for x in search.ask()]
        cases = [Case(study.design, regulator.program(program(x))) for x in asked]
        motions = Simulator(GRID, time_step=QUICK).motions(cases, [wanted.times] * len(cases))
        values = [1e3 * min(wanted.mean_distance(frames), 1.0) for frames in motions]
        if min(values) < least:
            best, least = asked[int(np.argmin(values))], min(values)
        search.tell(asked, values)
    [motion_of_best] = Simulator(GRID).motions([Case(study.design, regulator.program(program(best)))], [wanted.times])
    return rms(study, motion_of_best)


def on_device(number: int, folder: Path, say: Callable[[str], None]) -> dict[str, Any]:
    """A motion of a specimen with lag, droop and hysteresis, made by a program that is not used. mm: what the rig's
    motion is off."""
    motion, layout = Motion("ramps", 2 * number + 1), LAYOUTS[2 * number + 1][0]
    design = build(layout, muscles=2)
    rig = Rig("one", f"device_{number}", (layout, 2), 40 + number, DEVICE)
    place = folder / rig.name
    hidden = PressureProgram(_cycles(motion), motion.program(2), motion.seconds)
    if not (place / "wanted" / "set.toml").is_file():
        measure(rig, [hidden, hidden], place / "wanted")
    first, again = read_set(place / "wanted").trials
    study = FollowStudy(
        rig.name, design, MovingTarget(first.file), scatter=MotionScatter(copies=0), points_per_side=GRID
    )
    wanted = wanted_of(study)

    def off(trial: Trial) -> float:
        data = trial.load()
        frames = [data.frames[int(np.argmin(np.abs(data.time - t)))] for t in wanted.times]
        return 1e3 * float(np.mean([both_ways(a, b.points) for a, b in zip(frames, wanted.targets, strict=True)]))

    def run(result: FollowResult, name: str) -> float:
        measure(rig, [result.program], place / name)
        apart = off(read_set(place / name).trials[0])
        say(f"{rig.name} {name}: {apart:.3f} mm")
        return apart

    row: dict[str, Any] = {"device": rig.name, "floor": off(again)}
    row["data_sheet"] = run(run_follow(study, place / "sheet", force=True), "sheet_run")
    known = replace(study, model=calibrated(rig, design, place))
    row["calibrated"] = run(run_follow(known, place / "model", force=True), "run_0")
    for turn in range(1, 4):
        result = run_follow(known, place / "model", measured=place / f"run_{turn - 1}")
        row[f"repetition_{turn}"] = run(result, f"run_{turn}")
    return row


def _cycles(motion: Motion) -> Array:
    return CYCLE * np.arange(float(round(motion.seconds / CYCLE)))


def both_ways(one: Array, other: Array) -> float:
    """m, RMS of the distances from the points of a cloud to the plane of their nearest points of the other."""
    from scipy.spatial import cKDTree

    tree = cKDTree(other)
    _, neighbours = tree.query(one, k=8)
    patch = other[neighbours]
    middle = patch.mean(axis=1)
    normal = np.linalg.svd(patch - middle[:, None])[2][:, -1]
    height = np.abs(np.einsum("nd,nd->n", one - middle, normal))
    return float(np.sqrt(np.square(np.minimum(height, 0.01)).mean()))


def calibrated(rig: Rig, design: Design, place: Path) -> Model:
    """What two other motions of the specimen say of the three effects and the factors that matter most here."""
    file = place / "model.toml"
    if file.is_file():
        return read_model(file)
    others = [Motion("waves", 1), Motion("steps", 1)]
    times: Array = CYCLE * np.arange(30.0)
    programs = [PressureProgram(times, motion.program(design.channels)[:30], 1.5) for motion in others]
    if not (place / "others" / "set.toml").is_file():
        measure(rig, programs, place / "others")
    vector = fit_vector(tuple(DEVICE), FIXED, where="bench")
    options = CalibrationOptions(slopes=Simulator(GRID, time_step=QUICK), points_per_side=GRID)
    calibration = calibrate_sets(read_set(place / "others"), Simulator(GRID), vector=vector, options=options)
    write_model(calibration.model, file)
    return calibration.model


_HEAD = (
    "| motion | s | error over floor | mm | floor, mm | from shapes at rest, mm | first answer, mm | first, s (CPU s) "
    "| all, s (CPU s) | CMA-ES, mm |"
)
_DEVICES = "| device, mm | data sheet | calibrated | after one | after two | after three | floor |"


def page(rows: Sequence[dict[str, Any]]) -> str:
    """The tables."""
    motions = [row for row in rows if "motion" in row]
    lines = [f"At {commit(PAGE)}, {processor()}.", "", _HEAD, "|---" * 10 + "|"]
    for row in motions:
        cma = f"{row['cma']:.2f}" if "cma" in row else ""
        lines.append(
            f"| {row['motion']} | {row['seconds']:g} | {row['ratio']:.2f} | {row['error']:.3f} | {row['floor']:.3f} | "
            f"{row['from_rest']:.2f} | {row['first_error']:.2f} | {row['first']:.0f} ({row['first_cpu']:.0f}) | "
            f"{row['wall']:.0f} ({row['cpu']:.0f}) | {cma} |"
        )
    devices = [row for row in rows if "device" in row]
    if devices:
        lines += ["", _DEVICES, "|---" * 7 + "|"]
        keys = ("data_sheet", "calibrated", "repetition_1", "repetition_2", "repetition_3", "floor")
        lines += [f"| {row['device']} | " + " | ".join(f"{row[key]:.2f}" for key in keys) + " |" for row in devices]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--page", action="store_true")
    parser.add_argument("--cma", action="store_true", help="CMA-ES besides, on the motions named")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    file = given.folder / "results.jsonl"
    rows = {}
    for line in file.read_text().splitlines() if file.is_file() else []:
        row = json.loads(line)
        rows[row.get("motion") or row["device"]] = row
    names = given.names or [*(motion.name for motion in MOTIONS), "device_0", "device_1"]
    for name in names:
        if name not in rows:
            if name.startswith("device"):
                rows[name] = on_device(int(name[-1]), given.folder, print)
            else:
                rows[name] = followed(next(motion for motion in MOTIONS if motion.name == name), given.folder)
        if given.cma and "motion" in rows[name] and "cma" not in rows[name]:
            motion = next(motion for motion in MOTIONS if motion.name == name)
            rows[name]["cma"] = by_cma(motion, given.folder, TIMES * rows[name]["cpu"])
        print(json.dumps(rows[name]), flush=True)
        write_text(file, "".join(json.dumps(row) + "\n" for row in rows.values()))
    tables = page([*rows.values()])
    print(tables)
    if given.page:
        write_part(PAGE, "table", tables)


if __name__ == "__main__":
    main()
