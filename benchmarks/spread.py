"""Prediction intervals against measurements: coverage, width and CRPS of 90 % intervals of a predicted motion.

    python -m benchmarks.spread SET --model M.toml [--grid N] [--most K] -o TABLE.md

Predicted is the mean height of the cloth in each of nine regions at every sixth frame, along the normal of the
predicted mid-surface. Trials: those that the model was not fitted to, at most K of a design, spread over the session.
Three widths: the joint covariance of the model alone (draws, simulated); a constant; both and a share of how far the
region has moved since rest, as `studies.intervals` calibrates it. The last two are calibrated on the other trials,
whole trials left out in turn: least CRPS, then scaled so that 90 % of the others' residuals are inside.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.machine import commit
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model
from fabdesign.nouns.array import Array
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import MeasurementSet, Trial
from fabdesign.output import write_text
from fabdesign.units import in_mm
from studies.intervals.calibrate import IntervalScore, left_out
from studies.intervals.draws import RegionResiduals, residuals
from studies.measured.splits import of_each_design

DRAWS = 16


def trials_of(measured: MeasurementSet, model: Model, most: int) -> list[Trial]:
    """Not fitted, spread over the session."""
    fitted = {name.rpartition("/")[2] for name in model.provenance.fitted}
    return of_each_design([trial for trial in measured.trials if trial.name not in fitted], most)


def constant(one: RegionResiduals) -> RegionResiduals:
    """The same residuals, of which nothing but a constant says how wide they spread."""
    return replace(one, deviation=0 * one.deviation, moved=0 * one.moved)


def widths(every: Sequence[RegionResiduals]) -> dict[str, list[Array]]:
    """(n,) m, standard deviations by way and trial, each trial's calibrated on the others."""
    folds = range(len(every))
    return {
        "joint covariance alone": [one.deviation for one in every],
        "constant": left_out([constant(one) for one in every], folds),
        "all": left_out(every, folds),
    }


def table(every: Sequence[RegionResiduals]) -> str:
    lines = ["| design | trials | width | inside (90 %) | mean width, mm | CRPS, mm |", "|---|---|---|---|---|---|"]
    by_way = widths(every)
    for design in [*sorted({one.design for one in every}), "all"]:
        indices = [k for k, one in enumerate(every) if design in (one.design, "all")]
        residual = np.concatenate([every[k].residual for k in indices])
        for name, sigmas in by_way.items():
            score = IntervalScore.of(residual, np.concatenate([sigmas[k] for k in indices]))
            width, mean = in_mm(score.width), in_mm(score.crps)
            lines.append(f"| {design} | {len(indices)} | {name} | {score.inside:.0%} | {width:.2f} | {mean:.3f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    from sim import Simulator

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--grid", type=int)
    parser.add_argument("--most", type=int, default=10, help="Trials of a design.")
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    model = read_model(options.model).without(["corrector"])
    trials = trials_of(read_set(options.set), model, options.most)
    simulator = Simulator(options.grid or model.points_per_side)
    every = residuals(trials, Predictor(simulator, model, sensing=True), simulator, draws=DRAWS)
    text = f"Commit {commit()}.\n\n" + table(every)
    write_text(options.output, text)
    print(text)


if __name__ == "__main__":
    main()
