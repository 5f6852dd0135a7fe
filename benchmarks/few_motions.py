"""What few motions are worth: models fitted to 5, 8, 10 and 16 trials, and with named and learned terms together.

    python -m benchmarks.few_motions SET --work FOLDER [--only NAME ...] -o TABLE.md

Trials to fit are given by their place in the session, by a rule that was fixed before any result was seen: the session
of *basic* is halved again and again (0, 38, 75; 19, 57; 28, 66; 9, 47, and two of the widest gaps, 33 and 52), so that
the smaller number is part of the larger. Places below 26 and below 10 are those of *side* and *cross* too. Judged are
the trials of *basic* at every seventh place from 4 on, none of which is fitted, and *vertical*, whose trials are of
role test. The models of twelve trials are judged on the trials that `train` keeps back and `calibrate` did not fit.

`learned-told-10` has the five trials of `learned-5` and five more of those not judged, by designs and pressures alone:
those that by its covariance tell most together of the motions of all (studies/unseen/prediction.py), but for those
that the simulator calls sensitive in over a fifth of their frames.

Surface RMS at every sixth frame, each motion once on 21 points a side. A model is fitted where FOLDER has none, without
the intervals of motions, which take no part here. Of up to 32 trials `calibrate` fits 16, so there is no row of more.
Shares closed are of the excess of the factors alone of 10 trials, or of the twelve.
"""

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.machine import commit
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model, write_model
from fabdesign.geometry.metrics import Errors, closed, mean_errors, trial_errors
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import MeasurementSet, Trial
from fabdesign.output import write_text
from fabdesign.study_files.unseen_file import CandidateMeasurement
from fabdesign.units import in_mm
from optimize.fit.free_parameters import fit_vector
from optimize.fit.parameters import FitVector
from studies.calibration.calibrate import CalibrationOptions, calibrate_sets
from studies.measured.fit_data import noise_of
from studies.measured.used_frames import GRID, find_used_frames
from studies.training.data import TrainingOptions, choose
from studies.unseen.prediction import Draws, in_turn, information

FIVE = (0, 38, 75)
EIGHT = (*FIVE, 19, 57)
TEN = (*FIVE, 19, 28, 57, 66)
SIXTEEN = (*TEN, 9, 33, 47, 52)
TWELVE = (0, 10, 20, 30, 40, 50, 61, 71)
FIRST, EVERY = 5, 6  # frames
SENSITIVE = 0.2  # share of a trial's frames, above which it is not asked for


@dataclass(frozen=True)
class Plan:
    """A fit. free: as `calibrate --free` names it; orders: places of its trials in the session."""

    name: str
    free: tuple[str, ...]
    orders: tuple[int, ...]
    after: str | None = None  # a plan whose model says which trials are fitted besides, as many again


# The first of each part: its factors alone are what the others are compared with.
PLANS = (
    Plan("learned-10", ("learned",), TEN),
    Plan("learned-5", ("learned",), FIVE),
    Plan("learned-told-10", ("learned",), FIVE, after="learned-5"),
    Plan("learned-16", ("learned",), SIXTEEN),
    Plan("all-10", ("all",), TEN),
    Plan("all-5", ("all",), FIVE),
    Plan("all-8", ("all",), EIGHT),
    Plan("all-16", ("all",), SIXTEEN),
    Plan("learned-12", ("learned",), TWELVE),
    Plan("all-12", ("all",), TWELVE),
    Plan("both-12", ("all", "learned"), TWELVE),
)


def unknowns(plan: Plan, measured: MeasurementSet) -> FitVector:
    """As the command makes them."""
    return fit_vector(plan.free, designs=[*measured.designs.values()])


def fitted(plan: Plan, measured: MeasurementSet, work: Path) -> tuple[Model, float]:
    """The model of a plan and the processor seconds of its fit; kept in `work`."""
    from sim import Simulator

    file, spent = work / f"{plan.name}.toml", work / f"{plan.name}.cpu"
    if not file.is_file():
        work.mkdir(parents=True, exist_ok=True)
        began, simulator = time.process_time(), Simulator(GRID)
        trials = [t for t in measured.trials if t.role == "fit" and t.order in plan.orders]
        if plan.after:
            [first] = (one for one in PLANS if one.name == plan.after)
            more = informative_trials(fitted(first, measured, work)[0], measured, trials, simulator)
            print(f"{plan.name}: {', '.join(f'{t.name} of {t.design_name}' for t in more)}", flush=True)
            trials += more
            began = time.process_time()
        calibration = calibrate_sets(
            replace(measured, trials=tuple(trials)),
            simulator,
            vector=unknowns(plan, measured),
            progress=lambda line, share: print(f"{plan.name}: {line}", flush=True),
            options=CalibrationOptions(slopes=simulator, coarse=simulator, points_per_side=GRID, interruptible=True),
        )
        spent.write_text(f"{time.process_time() - began:.0f}")
        write_model(calibration.model, file)
    return read_model(file), float(spent.read_text())


def informative_trials(
    model: Model, measured: MeasurementSet, trials: Sequence[Trial], forward: ForwardModel
) -> list[Trial]:
    """As many trials more as there are `trials`, which the model was fitted to, of those that tell most together."""
    taken = {trial.name for trial in [*trials, *judged_on(measured, [PLANS[0]])]}
    candidates = [t for t in measured.trials if t.role == "fit" and t.name not in taken]
    used = find_used_frames([(measured, candidates)], forward)
    candidates = [t for t in candidates if used.at(measured, t).mean() > 1 - SENSITIVE]
    shown = [CandidateMeasurement(t.name, t.design, t.program) for t in candidates]
    draws = Draws(model, candidates[0].design)
    gained = information(shown, draws, Predictor(forward, Model(), sensing=True))
    known = {c.name: matrix for c, matrix in zip(shown, gained, strict=True) if np.isfinite(matrix).all()}
    of_all = np.asarray(np.linalg.cholesky(sum(known.values()) + 1e-9 * np.eye(len(draws.names))).T, dtype=float)
    chosen = in_turn(of_all, known, len(trials))
    return [t for t in candidates if t.name in chosen]


def judged_on(measured: MeasurementSet, plans: Sequence[Plan]) -> list[Trial]:
    vertical = [trial for trial in measured.trials if trial.design_name == "vertical"]
    basic = [t for t in measured.trials if t.design_name == "basic" and t.role == "fit" and t.order % 7 == 4]
    if any(plan.orders != TWELVE for plan in plans):
        return [*basic, *vertical]
    _, held = choose([measured], TrainingOptions())[:2]
    return [*(one.trial for one in held if one.trial.order not in TWELVE), *vertical]


def errors_of(trials: Sequence[Trial], model: Model) -> list[Errors]:
    from sim import Simulator

    noise, frames = noise_of(trials), slice(FIRST, None, EVERY)
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in trials]
    motions = Predictor(Simulator(GRID), model, sensing=True).motions(cases, [t.times[frames] for t in trials])
    clouds = [[trial.load().frames[k] for k in range(FIRST, len(trial.times), EVERY)] for trial in trials]
    return [trial_errors(c, m, noise, seed=t.order) for c, m, t in zip(clouds, motions, trials, strict=True)]


def table(trials: Sequence[Trial], models: Mapping[str, tuple[Model, float]]) -> str:
    """A row a model and design: beside the data sheet, and the factors alone of the first model's trials."""
    [base, *_] = (model.before for model, _ in models.values())
    sheet, before = errors_of(trials, Model()), errors_of(trials, base)
    lines = ["| model | fitted trials | CPU s | design | data sheet | factors alone | model | floor | closed | worse |"]
    lines.append("|---" * 10 + "|")
    notes = []
    for name, (model, spent) in models.items():
        after = errors_of(trials, model)
        for design in dict.fromkeys(trial.design_name for trial in trials):
            indices = [k for k, trial in enumerate(trials) if trial.design_name == design]
            means = [mean_errors([each[k] for k in indices]) for each in (sheet, before, after)]
            worse = sum(after[k].surface_rms > before[k].surface_rms for k in indices)
            shown = " | ".join(f"{in_mm(e.surface_rms):.2f}" for e in means)
            share = closed(means[1], means[2]).surface
            lines.append(
                f"| {name} | {len(model.provenance.fitted)} | {spent:.0f} | {design} | {shown} "
                f"| {in_mm(means[2].surface_floor):.2f} | {'' if share is None else f'{share:.0%}'} "
                f"| {worse} of {len(indices)} |"
            )
        by_trial = ", ".join(_shown(*each) for each in zip(trials, before, after, strict=True))
        notes.append(f"{name}, by trial, factors alone to model: {by_trial}")
    return "\n".join([*lines, "", *notes]) + "\n"


def _shown(trial: Trial, before: Errors, after: Errors) -> str:
    return f"{trial.name} {in_mm(before.surface_rms):.2f} to {in_mm(after.surface_rms):.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--only", nargs="*", choices=[plan.name for plan in PLANS])
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    measured = read_set(options.set)
    plans = [plan for plan in PLANS if not options.only or plan.name in options.only]
    parts = [f"Commit {commit()}."]
    for group in ([p for p in plans if p.orders != TWELVE], [p for p in plans if p.orders == TWELVE]):
        models = {plan.name: fitted(plan, measured, options.work) for plan in group}
        if models:
            parts.append(table(judged_on(measured, group), models))
    write_text(options.output, "\n\n".join(parts))
    print("\n\n".join(parts))


if __name__ == "__main__":
    main()
