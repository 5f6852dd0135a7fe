"""Prediction intervals on layouts that nothing was fitted to or calibrated on: ten layouts of the virtual rig.

    python -m benchmarks.spread_layouts --work FOLDER [--free learned] -o TABLE.md

Each layout has two to six muscles on one cloth and is drawn by its number; each is measured in six trials of two random
pressures a channel. The rig (synthetic) has factors and three effects that the model does not declare: filling lag,
orthotropy, a little rest curvature. `calibrate` fits factors, and what --free names, to 16 trials of the even layouts
and calibrates the intervals on the others of these. Judged are the odd layouts' trials, beside two constant widths:
one calibrated on the same trials, and the one that holds as many of the judged residuals as the model's intervals do,
which no prediction can know. FOLDER keeps the set and the model.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.machine import commit
from benchmarks.spread import constant
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model
from fabdesign.interface import calibrate
from fabdesign.nouns.catalogue import standard
from fabdesign.nouns.design import Design
from fabdesign.nouns.model import NORMAL90, Model
from fabdesign.nouns.muscle import Muscle
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.nouns.trial import MeasurementSet, Trial
from fabdesign.output import write_text
from fabdesign.units import in_mm
from studies.intervals.calibrate import MOST, IntervalScore, calibrated
from studies.intervals.draws import RegionResiduals, residuals
from studies.measured.splits import of_each_design
from studies.measured.used_frames import find_used_frames
from studies.rig import EffectSetting, GroundTruth, RigSession, Sensing, run_rig
from studies.rig.scene import Resolution

LAYOUTS, TRIALS = 10, 6
SECONDS, LEVELS = 1.5, (0.0, 100e3, 200e3, 300e3)  # s, Pa
GRID = 21
RIG = Resolution(element=0.0125, step=1 / 480)  # coarser than its default, which costs some ten times as much
TRUTH = GroundTruth(
    seed=39,
    parameters={"membrane": 1.1, "bending": 0.9, "damping": 1.2, "muscle_gain": 1.05, "axis_offset": 0.95},
    effects=(
        EffectSetting("filling_lag", {"fill": 0.12, "empty": 0.2}),
        EffectSetting("orthotropy", {"ratio": 1.6}),
        EffectSetting("rest_curvature", {"down": 0.8}),
    ),
    sensing=Sensing(frame_rate=20.0, points=800),
)


def layout(number: int) -> Design:
    """Muscles in strips of equal width, oblique by up to 50 mm, down or across, most of them in front."""
    base, rng, count = standard(), np.random.default_rng(number), 2 + number % 5
    fabric, kind = base.fabric, base.muscle_types["EM20"]
    muscles = []
    for channel in range(count):
        begin = (channel + 0.5) / count * fabric.width + rng.uniform(-0.01, 0.01)
        end = np.clip(begin + rng.uniform(-0.05, 0.05), 0.01, fabric.width - 0.01)
        path = (round(float(begin), 4), 0.008), (round(float(end), 4), fabric.height - 0.008)
        if rng.random() < 0.25:
            path = tuple((v, u) for u, v in path)  # type: ignore[assignment]
        muscles.append(Muscle(kind.name, "front" if rng.random() < 0.7 else "back", channel, path, 0.02))
    return Design(f"layout_{number}", fabric, {kind.name: kind}, tuple(muscles))


def programs(number: int, channels: int) -> list[PressureProgram]:
    rng = np.random.default_rng([number, 1])
    rows = rng.choice(LEVELS, (TRIALS, 2, channels))
    return [PressureProgram(np.array([0.0, SECONDS / 2]), row, SECONDS) for row in rows]


def measured_in(folder: Path) -> MeasurementSet:
    """The ten layouts in one session, measured where the folder has no set."""
    if not (folder / "set").is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        session = [(design, programs(k, design.channels)) for k, design in enumerate(map(layout, range(LAYOUTS)))]
        run_rig(
            RigSession(session, TRUTH, resolution=RIG),
            folder / "set",
            workers=1,
            progress=lambda done, total: print(f"measured: {done} of {total}", flush=True),
        )
    return read_set(folder / "set")


def table(model: Model, spared: Sequence[RegionResiduals], others: Sequence[RegionResiduals]) -> str:
    """spared: of the trials that the intervals are calibrated on, others: of the trials judged."""
    assert model.spread is not None
    spread, flat = model.spread, calibrated([constant(one) for one in spared])
    lines = [
        "| layout | trials | 90 % interval from | inside | mean width, mm | CRPS, mm |",
        "|---|---|---|---|---|---|",
    ]
    for name in ["all", *sorted({one.design for one in others})]:
        some = [one for one in others if name in (one.design, "all")]
        residual = np.concatenate([one.residual for one in some])
        sigma = np.concatenate([o.sigma(spread) for o in some])
        scores = {
            "the model": IntervalScore.of(residual, sigma),
            "the joint covariance alone": IntervalScore.of(residual, np.concatenate([o.deviation for o in some])),
            "a constant": IntervalScore.of(residual, np.concatenate([constant(o).sigma(flat) for o in some])),
        }
        same = np.quantile(np.abs(residual), scores["the model"].inside) / NORMAL90
        scores["a constant that holds as many"] = IntervalScore.of(residual, np.full(len(residual), same))
        for what, score in scores.items():
            inside, width, crps = score.shown
            lines.append(f"| {name} | {len(some)} | {what} | {inside:.0%} | {width:.2f} | {crps:.3f} |")
    return "\n".join(lines) + "\n"


def odd(trial: Trial) -> bool:
    return int(trial.design_name.rpartition("_")[2]) % 2 == 1


def main() -> None:
    from sim import Simulator

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--free", default="", help="As `calibrate --free` takes it.")
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    began = time.process_time()
    measured, file = measured_in(options.work), options.work / f"model_{options.free or 'factors'}.toml"
    spent = {"measured": time.process_time() - began}
    known = [trial for trial in measured.trials if not odd(trial)]
    if not file.is_file():
        free = options.free.split(",") if options.free else []
        fit_set = replace(measured, trials=tuple(known))
        calibrate([fit_set], file, free=free, grid=GRID, progress=lambda line, share: print(line, flush=True))
    spent["calibrated"] = time.process_time() - began - sum(spent.values())
    model, simulator = read_model(file), Simulator(GRID)
    predictor, fitted = Predictor(simulator, model, sensing=True), set(model.provenance.fitted)
    spared = of_each_design([trial for trial in known if f"{measured.name}/{trial.name}" not in fitted], MOST)
    judged = [trial for trial in measured.trials if odd(trial)]
    used = find_used_frames([(measured, [*spared, *judged])], simulator)
    both = [
        residuals(trials, predictor, simulator, used=lambda trial: used.at(measured, trial))
        for trials in (spared, judged)
    ]
    spent["judged"] = time.process_time() - began - sum(spent.values())
    cost = ", ".join(f"{what} in {seconds:.0f}" for what, seconds in spent.items())
    rms = in_mm(float(np.sqrt(np.mean(np.square(np.concatenate([one.residual for one in both[1]]))))))
    text = f"Commit {commit()}; CPU s: {cost}. Heights of the judged trials: {rms:.2f} mm RMS.\n\n"
    text += table(model, *both)
    write_text(options.output, text)
    print(text)


if __name__ == "__main__":
    main()
