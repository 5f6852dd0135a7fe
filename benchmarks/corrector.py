"""What models and their correctors are worth beside simple baselines, on trials that none of them has seen.

    python -m benchmarks.corrector SET --model NAME=M.toml ... [--test DESIGN ...] [--drop TRIAL ...] --cache FOLDER \\
        -o TABLE.md

Judged are the trials of role `fit` that every model's file lists as held out, less those that one of them was fitted
to and those of `--drop`, and the trials of role `test` of each `--test DESIGN`: all models on the same frames. Rows,
for each grid that a model was fitted on: the data sheet; the factors alone, fitted without effects, of the first model
on that grid; each model without its corrector, and with it; and three baselines that add residuals to the factors
alone: the mean residual field of the design's trials that a model was fitted to (of all such trials, where the design
has none), that of the trial with the nearest pressures, and the trial's own residual of the frame before, carried on
(which needs its measurement, so that it is no prediction). Residuals are heights over the simulated mid-surface, node
by node. A trial is worse where its surface RMS is above that of the factors alone. An unordered answer has no surface.
"""

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import commit
from corrector.field import load_corrector, offsets
from corrector.shape import FINE, LocalFrames, displaced
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model
from fabdesign.geometry.metrics import Errors, closed, mean_errors, trial_errors
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.geometry.shape import Shape
from fabdesign.nouns.forward import Case, with_history
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import MeasurementSet, Trial
from fabdesign.output import write_text
from fabdesign.units import in_mm
from studies.measured.fit_data import noise_of
from studies.prediction.evaluate import unordered_errors

FIRST, EVERY = 5, 6  # frames: the sixth, and every sixth from there on
HISTORY = tuple(k / 30 for k in range(1, 10))  # s, that both networks find theirs in
Motion = NDArray[np.float32]


class Simulated:
    """Motions of trials, kept in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def of(self, trials: Sequence[Trial], model: Model) -> dict[str, Motion]:
        """(U, 2 n, 3) m at `with_history(trial.times, HISTORY)`, without a corrector, by the trial's name."""
        model = model.without(["corrector"])
        missing = [t for t in trials if not self._file(model, t).is_file()]
        if missing:
            from sim import Simulator

            predictor = Predictor(Simulator(model.points_per_side), model, sensing=True)
            for k in range(0, len(missing), 32):
                part = missing[k : k + 32]
                cases = [Case(t.design, t.program, order=t.order) for t in part]
                wanted = [with_history(t.times, HISTORY)[0] for t in part]
                for trial, motion in zip(part, predictor.motions(cases, wanted), strict=True):
                    np.save(self._file(model, trial), motion)
        return {t.name: np.load(self._file(model, t)) for t in trials}

    def _file(self, model: Model, trial: Trial) -> Path:
        return self.folder / f"{model.central_hash[:16]}-{model.points_per_side}-{trial.name}.npy"


@dataclass(frozen=True)
class Row:
    """What answers, on how many points a side, and the errors of each trial by its name."""

    name: str
    points_per_side: int
    errors: Mapping[str, Errors]


def frames_of(trial: Trial) -> NDArray[np.intp]:
    return np.arange(FIRST, len(trial.times), EVERY)


def residuals(trial: Trial, motion: Motion, frames: NDArray[np.intp]) -> NDArray[np.float32]:
    """(F, FINE, FINE) m over the simulated mid-surface."""
    middle = Shape(_plain(trial, motion)[frames]).middle
    clouds, thickness = trial.load().frames, trial.design.fabric.thickness
    pairs = [offsets(m, clouds[k], thickness) for m, k in zip(middle, frames, strict=True)]
    return np.array([offset * (count > 0) for offset, count in pairs], dtype=np.float32)


def moved(trial: Trial, motion: Motion, heights: NDArray[np.float32]) -> Motion:
    """The simulated frames with their mid-surface moved by heights (F, FINE, FINE) m along its normal."""
    points, fabric = _judged(trial, motion), trial.design.fabric
    normal = LocalFrames.of(Shape(points).middle, fabric.width, fabric.height, FINE).normal
    return displaced(points, heights[..., None] * normal, fabric.thickness)


def _plain(trial: Trial, motion: Motion) -> Motion:
    return motion[with_history(trial.times, HISTORY)[1][0]]


def _judged(trial: Trial, motion: Motion) -> Motion:
    return _plain(trial, motion)[frames_of(trial)]


def _judged_of(trials: Sequence[Trial], motions: Mapping[str, Motion]) -> dict[str, Motion]:
    return {trial.name: _judged(trial, motions[trial.name]) for trial in trials}


def corrected(model: Model) -> tuple[Callable[[Trial, Motion], Motion], bool]:
    """What makes a trial's corrected frames of its simulated motion, and whether their points are ordered."""
    corrector = load_corrector(model)

    def answer(trial: Trial, motion: Motion) -> Motion:
        times = trial.times[frames_of(trial)]
        have, _ = with_history(trial.times, HISTORY)
        wanted, _ = with_history(times, corrector.history())
        row = np.abs(wanted[:, None] - have).argmin(axis=1)
        if np.abs(wanted - have[row]).max() > 1e-4:
            raise ValueError("trials whose frames are not 1/30 s apart")
        case = Case(trial.design, trial.program, model.factors, model.terms, trial.order)
        return corrector.correct([case], [times], [motion[row]])[0]

    return answer, corrector.ordered


def judged_on(
    measured: MeasurementSet, models: Sequence[Model], *, tests: Sequence[str] = (), dropped: Sequence[str] = ()
) -> tuple[list[Trial], list[Trial]]:
    """Trials judged, and those of role `fit` that a model or its corrector was fitted to."""
    fitted = {name for model in models for name in model.provenance.fitted}
    held = set.intersection(*(set(model.provenance.held_out) for model in models)) - fitted

    def named(trial: Trial, names: set[str]) -> bool:
        return f"{measured.name}/{trial.name}" in names

    fit = [trial for trial in measured.trials if trial.role == "fit"]
    asked = [trial for trial in fit if named(trial, held) and trial.name not in dropped]
    asked += [t for t in measured.trials if t.role == "test" and t.design_name in tests and not named(t, fitted)]
    return asked, [trial for trial in fit if named(trial, fitted)]


def rows_of(
    models: Mapping[str, Model], asked: Sequence[Trial], learned: Sequence[Trial], cache: Simulated
) -> Iterator[Row]:
    """The first two of a grid are the data sheet and the factors alone."""
    designs = dict.fromkeys(trial.design_name for trial in asked)
    noises = {name: noise_of([t for t in asked if t.design_name == name]) for name in designs}
    for grid in dict.fromkeys(model.points_per_side for model in models.values()):
        models_of_grid = {name: model for name, model in models.items() if model.points_per_side == grid}
        sheet = cache.of(asked, Model(points_per_side=grid))
        yield Row("data sheet", grid, _errors(asked, _judged_of(asked, sheet), noises))
        plain = cache.of([*asked, *learned], next(iter(models_of_grid.values())).before)
        alone = Row("factors alone", grid, _errors(asked, _judged_of(asked, plain), noises))
        yield alone
        for name, answers in _baselines(plain, asked, learned).items():
            yield Row(f"factors alone, {name}", grid, _errors(asked, answers, noises))
        for name, model in models_of_grid.items():
            bare = cache.of(asked, model)
            if model.effects or model.corrector is None:
                yield Row(name, grid, _errors(asked, _judged_of(asked, bare), noises))
            if model.corrector is not None:
                answer, ordered = corrected(model)
                answers = {trial.name: answer(trial, bare[trial.name]) for trial in asked}
                floors = None if ordered else alone.errors
                yield Row(f"{name}, corrected", grid, _errors(asked, answers, noises, floors))


def _errors(
    asked: Sequence[Trial],
    answers: Mapping[str, Motion],
    noises: Mapping[str, SensorNoise],
    floors: Mapping[str, Errors] | None = None,
) -> dict[str, Errors]:
    """Of the trials that have an answer. floors: of unordered answers, errors whose Chamfer floor they have."""
    errors = {}
    for trial in (t for t in asked if t.name in answers):
        frames, answer = trial.load().frames, answers[trial.name]
        clouds = [frames[k] for k in frames_of(trial)]
        if floors is None:
            errors[trial.name] = trial_errors(clouds, answer, noises[trial.design_name], seed=trial.order)
        else:
            errors[trial.name] = unordered_errors(clouds, answer, floors[trial.name].chamfer_floor)
    return errors


def _baselines(
    plain: Mapping[str, Motion], asked: Sequence[Trial], learned: Sequence[Trial]
) -> dict[str, dict[str, Motion]]:
    fields = {t.name: residuals(t, plain[t.name], frames_of(t)) for t in learned}
    mean, nearest, last = dict[str, Motion](), dict[str, Motion](), dict[str, Motion]()
    for trial in asked:
        motion = plain[trial.name]
        of_design = [t for t in learned if t.design_name == trial.design_name]
        mean[trial.name] = moved(trial, motion, np.mean([fields[t.name] for t in of_design or learned], axis=0))
        if of_design:
            apart = [float(np.abs(t.program.pressure - trial.program.pressure).sum()) for t in of_design]
            nearest[trial.name] = moved(trial, motion, fields[of_design[int(np.argmin(apart))].name])
        last[trial.name] = moved(trial, motion, residuals(trial, motion, frames_of(trial) - 1))
    return {"mean residual field": mean, "nearest trial's residual": nearest, "last frame's residual": last}


def table(rows: Sequence[Row], asked: Sequence[Trial]) -> str:
    """Surface RMS, share of the excess removed over the factors alone of the same grid, trials made worse, Chamfer."""
    groups: dict[str, list[str]] = {}
    for trial in asked:
        groups.setdefault(f"*{trial.design_name}*" + " of role test" * (trial.role == "test"), []).append(trial.name)
    head = " | ".join(
        f"{title}, {len(names)}: surface RMS | closed | worse | Chamfer" for title, names in groups.items()
    )
    lines = [f"| | points a side | {head} |", "|---" * (2 + 4 * len(groups)) + "|"]
    alone = {row.points_per_side: row for row in rows if row.name == "factors alone"}
    for row in rows:
        cells = [cell for names in groups.values() for cell in _cells(row, alone[row.points_per_side], names)]
        lines.append(f"| {row.name} | {row.points_per_side} | {' | '.join(cells)} |")
    floors = [mean_errors([rows[0].errors[name] for name in names]) for names in groups.values()]
    shown = " | ".join(f"{in_mm(e.surface_floor):.2f} | | | {in_mm(e.chamfer_floor):.2f}" for e in floors)
    lines.append(f"| noise floor | | {shown} |")
    for row in rows:
        each = ", ".join(f"{name} {in_mm(errors.surface_rms):.2f}" for name, errors in row.errors.items())
        lines.append(f"\n{row.name}, {row.points_per_side} points a side, by trial: {each}")
    return "\n".join(lines) + "\n"


def _cells(row: Row, alone: Row, names: Sequence[str]) -> list[str]:
    """Four, empty where the row says nothing of these trials."""
    if not all(name in row.errors for name in names):
        return [""] * 4
    mean, before = (mean_errors([one.errors[name] for name in names]) for one in (row, alone))
    chamfer = f"{in_mm(mean.chamfer):.2f}"
    if not np.isfinite(mean.surface_rms):
        return ["", "", "", chamfer]
    share = closed(before, mean).surface
    comparison = ["", ""]
    if row is not alone and share is not None:
        worse = sum(row.errors[name].surface_rms > alone.errors[name].surface_rms for name in names)
        comparison = [f"{100 * share:.0f} %", f"{worse}"]
    return [f"{in_mm(mean.surface_rms):.2f}", *comparison, chamfer]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("--model", action="append", required=True, metavar="NAME=M.toml")
    parser.add_argument("--test", action="append", default=[], help="A design whose trials of role test are judged.")
    parser.add_argument("--drop", action="append", default=[], help="A trial that is not judged.")
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    measured = read_set(options.set)
    models = {name: read_model(file) for name, _, file in (item.partition("=") for item in options.model)}
    asked, learned = judged_on(measured, [*models.values()], tests=options.test, dropped=options.drop)
    rows = [*rows_of(models, asked, learned, Simulated(options.cache))]
    head = f"`python -m benchmarks.corrector`, commit {commit()}; mm, frames 6 to the end, every sixth."
    text = f"{head}\n\n{table(rows, asked)}"
    write_text(options.output, text)
    print(text)


if __name__ == "__main__":
    main()
