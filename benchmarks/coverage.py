"""Do calibration's intervals hold the truth? Effect-free sets of the virtual rig, whose factors are known.

    python -m benchmarks.coverage engine FOLDER       # 20 sets: the term for the difference between engines
    python -m benchmarks.coverage test FOLDER         # 20 others: how many true factors lie inside the intervals
    python -m benchmarks.coverage test FOLDER --grid 41

Each set: a catalogue layout, factors drawn from calibration's prior, four trials of 1.5 s with random pressures to fit
and one more to hold out. Two sets at a time; those already calibrated, in FOLDER/results_61.jsonl, are not done again.
`engine` writes its column of studies/fitting/engine_difference.csv, `test` docs/lab/coverage.md, or
coverage_41.md with 41 points a side.
"""

import argparse
import json
import multiprocessing
import platform
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student

from benchmarks.engines import write_column
from benchmarks.machine import commit
from fabdesign.files.measurement_set import read_set
from fabdesign.geometry.metrics import trial_errors
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import PARAMETERS, Case
from fabdesign.nouns.model import NORMAL90, POINTS_PER_SIDE, Model, Parameter
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.output import write_text
from optimize.fit.parameters import PRIOR
from sim import Simulator
from studies.calibration.calibrate import CalibrationOptions, calibrate_sets
from studies.fitting.fitted_model import data_share, engine_difference
from studies.measured.fit_data import noise_of
from studies.rig import RigSession, run_rig
from studies.rig.run import end_with_parent
from studies.rig.specimen import GroundTruth

LAYOUTS = (("basic", 4), ("side", 4), ("cross", 2), ("vertical", 3))
FIRST = {"engine": 1000, "test": 60}  # seed of the first set; a change of the fit wants tests that nobody looked at
COUNT = {"engine": 20, "test": 20}
GRID = 61  # as `fabdesign calibrate`
AT_ONCE = 2  # sets
HELD_OUT = ("data sheet", "calibrated", "true factors")


def make(seed: int, folder: Path) -> dict[str, float]:
    """Write the set; its true factors."""
    rng = np.random.default_rng(seed)
    layout, muscles = LAYOUTS[seed % len(LAYOUTS)]
    design = build(layout, muscles=muscles)
    factors = {name: float(np.exp(PRIOR[name] * np.clip(rng.standard_normal(), -2, 2))) for name in PARAMETERS}
    programs = [
        PressureProgram(np.array([0.0, 0.5, 1.0]), rng.uniform(0, 400e3, (3, design.channels)), 1.5) for _ in range(5)
    ]
    run_rig(RigSession([(design, programs)], GroundTruth(seed, factors), test_trials=1), folder)
    return factors


def excess(fitted: Model, known: Model, measured: MeasurementSet, simulator: Simulator) -> list[float]:
    """m, of the held-out trial over the floor, in quadrature: at the data sheet, with either model."""
    [trial] = [trial for trial in measured.trials if trial.role == "test"]
    clouds, noise = trial.load().frames, noise_of([trial])
    cases = [Case(trial.design, trial.program, factors) for factors in ({}, fitted.factors, known.factors)]
    motions = simulator.motions(cases, [trial.times] * len(cases))
    errors = [trial_errors(clouds, motion, noise, seed=trial.order) for motion in motions]
    return [e.excess for e in errors]


def calibrated(seed: int, folder: Path, grid: int) -> dict[str, Any]:
    """Everything that is kept of one set: logarithms, their standard deviations without the engines' term; m of the
    held-out trial at the data sheet, calibrated and with the true factors."""
    begin = time.perf_counter()
    simulator = Simulator(points_per_side=grid)
    factors = make(seed, folder)
    measured = read_set(folder)
    slopes = Simulator(points_per_side=min(grid, POINTS_PER_SIDE))
    calibration = calibrate_sets(measured, simulator, options=CalibrationOptions(slopes=slopes, points_per_side=grid))
    known = Model({name: Parameter(factor, (factor, factor)) for name, factor in factors.items()})
    return {
        "seed": seed,
        "layout": LAYOUTS[seed % len(LAYOUTS)][0],
        "truth": [float(np.log(factors[name])) for name in PARAMETERS],
        "found": calibration.fit.x.tolist(),
        "deviation": np.sqrt(np.diag(calibration.fit.covariance)).tolist(),
        "excess": excess(calibration.model, known, measured, simulator),
        "converged": calibration.fit.converged,
        "seconds": time.perf_counter() - begin,
    }


def results(kind: str, folder: Path, grid: int) -> list[dict[str, Any]]:
    """Of all sets of the kind; those that are missing are made first."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / f"results_{grid}.jsonl"
    lines = kept.read_text().splitlines() if kept.exists() else []
    done = {row["seed"]: row for row in map(json.loads, lines)}
    seeds = range(FIRST[kind], FIRST[kind] + COUNT[kind])
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(AT_ONCE, mp_context=spawn, initializer=end_with_parent) as pool:
        waiting = [pool.submit(calibrated, s, folder / f"set_{s}", grid) for s in seeds if s not in done]
        for future in as_completed(waiting):
            row = future.result()
            done[row["seed"]] = row
            with kept.open("a") as stream:
                stream.write(json.dumps(row) + "\n")
            print(row["seed"], row["layout"], f"{row['seconds']:.0f} s", flush=True)
    return [done[seed] for seed in seeds]


def errors(rows: list[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """(sets, 7) of the logarithms found, and their own standard deviations."""
    return np.array([r["found"] for r in rows]) - [r["truth"] for r in rows], np.array([r["deviation"] for r in rows])


def engine_term(rows: list[dict[str, Any]]) -> np.ndarray:
    """(7,) what the errors' mean square has over the intervals' own variance, as a standard deviation; wider by what
    Student's quantile for so many sets is wider than the normal one."""
    error, deviation = errors(rows)
    beyond = (np.square(error) - np.square(deviation)).mean(axis=0) / np.square(data_share(deviation)).mean(axis=0)
    return np.sqrt(np.maximum(beyond, 0.0)) * float(student.ppf(0.95, len(rows))) / NORMAL90


def held_out(over: np.ndarray) -> str:
    """mm -> cells: how many are within what is asked for, the root mean square of all, their median and the worst."""
    pooled = np.sqrt(np.mean(np.square(over)))
    return f"{(over <= 0.5).sum()} of {len(over)} | {pooled:.2f} | {np.median(over):.2f} | {over.max():.2f}"


def page(rows: list[dict[str, Any]], extra: np.ndarray, grid: int) -> str:
    error, deviation = errors(rows)
    inside = np.abs(error) <= NORMAL90 * np.sqrt(deviation**2 + (data_share(deviation) * extra) ** 2)
    narrow = np.abs(error) <= NORMAL90 * deviation
    over = 1e3 * np.array([r["excess"] for r in rows])
    total = f"{inside.sum()} of {inside.size}"
    option = "" if grid == GRID else f" --grid {grid}"
    lines = [
        "# Do calibration's intervals hold the truth?",
        "",
        f"`python -m benchmarks.coverage test FOLDER{option}` at commit {commit()}, {platform.machine()}, 2 cores.",
        f"{len(rows)} sets of the virtual rig (synthetic), no effects, factors drawn from the prior, four trials of",
        "1.5 s fitted, a fifth held out. The term for the difference between engines comes from",
        f"{COUNT['engine']} other sets (docs/lab/calibration.md, Intervals); {grid} points a side.",
        "",
        f"True factors inside the 90 % intervals: **{total}** (asked: 119 of 140); without the engines' term",
        f"{narrow.sum()}.",
        "",
        "| held-out surface RMS over the noise, in quadrature | within 0.5 mm | pooled, mm | median | worst |",
        "|---|---|---|---|---|",
        *(f"| {name} | {held_out(column)} |" for name, column in zip(HELD_OUT, over.T, strict=True)),
        "",
        f"Seconds a set, {AT_ONCE} at a time, median: {np.median([r['seconds'] for r in rows]):.0f}.",
        f"Converged: {sum(r['converged'] for r in rows)} of {len(rows)}.",
        "",
        "| factor | inside | mean error | RMS error | own deviation, RMS | engines' term |",
        "|---|---|---|---|---|---|",
    ]
    for k, name in enumerate(PARAMETERS):
        values = (
            error[:, k].mean(),
            np.sqrt(np.mean(error[:, k] ** 2)),
            np.sqrt(np.mean(deviation[:, k] ** 2)),
            extra[k],
        )
        lines.append(
            f"| {name} | {inside[:, k].sum()} of {len(rows)} | " + " | ".join(f"{v:.3f}" for v in values) + " |"
        )
    lines += [
        "",
        "Errors and deviations are of the logarithms.",
        "",
        "Held-out surface RMS over the noise, in quadrature, mm:",
        "",
        "| set | layout | " + " | ".join(HELD_OUT) + " |",
        "|---|---|---|---|---|",
    ]
    for row, values in zip(rows, over, strict=True):
        lines.append(f"| {row['seed']} | {row['layout']} | " + " | ".join(f"{v:.2f}" for v in values) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("engine", "test"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--grid", type=int, default=GRID, help="points a side of the last iterations")
    given = parser.parse_args()
    rows = results(given.kind, given.folder, given.grid)
    if given.kind == "engine":
        write_column("virtual_rig", engine_term(rows))
    else:
        name = "coverage.md" if given.grid == GRID else f"coverage_{given.grid}.md"
        write_text(Path("docs/lab") / name, page(rows, engine_difference(), given.grid))


if __name__ == "__main__":
    main()
