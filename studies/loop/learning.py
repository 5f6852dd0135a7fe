"""Learning from a turn's measurements: an effect traced, all parameters refitted with it, a network for what
remains."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

from fabdesign.errors import InputError
from fabdesign.files.model_file import read_model, write_model
from fabdesign.formats.json_file import plain
from fabdesign.geometry.metrics import Errors
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.trial import Accuracy, MeasurementSet
from fabdesign.output import WorkFolder
from fabdesign.study_files.loop_file import LoopStudy
from fabdesign.units import in_mm
from optimize.fit.free_parameters import fit_vector
from studies.calibration import Calibration, CalibrationOptions, calibrate_sets
from studies.loop.record import Learned, TracedEffects
from studies.measured.used_frames import GRID
from studies.prediction.evaluate import evaluate_sets
from studies.prediction.forward_model import forward_model

MODEL = "model.toml"
TRACE = "trace"  # the folder of the trace

Simulators = Callable[[int], ForwardModel]  # by points a side
Say = Callable[[str], None]


def together(sets: Sequence[MeasurementSet]) -> MeasurementSet:
    """Return all turns' trials as one set, each turn's design by the turn's name."""
    if len(sets) == 1:
        return sets[0]
    return MeasurementSet(
        name=f"{sets[0].name} to {sets[-1].name}",
        designs={name: design for one in sets for name, design in one.designs.items()},
        trials=tuple(trial for one in sets for trial in one.trials),
        description=sets[0].description,
        frame_rate=sets[0].frame_rate,
        accuracy=Accuracy.worst([one.accuracy for one in sets]),
    )


def learn(
    study: LoopStudy,
    sets: Sequence[MeasurementSet],
    known: Model,
    work: WorkFolder,
    name: str,
    simulators: Simulators,
    *,
    say: Say,
) -> Learned:
    """Learn from the sets of all turns so far, and write `model.toml` in the folder of the turn `name`. known: the
    model that the turn's design was chosen with. A trace refits the declared parameters along; on another grid than the
    study's, or without one, they and the effects are fitted by `calibrate`. What cannot be is said, and left out."""
    measured, known, notes = together(sets), known.without(["corrector"]), []
    traced, model, started = None, None, known
    if study.learning.trace:
        traced, learned, lines = traced_by(study, measured, known, work.folder / name / TRACE, simulators, say)
        notes += lines
        if learned is not None:
            started = replace(known, effects=learned.effects)
            model = learned if study.learning.trace_grid == study.points_per_side else None
    if model is None:
        calibration = _calibrated(study, sets, started, simulators, say)
        model, remaining = calibration.model, in_mm(calibration.excess)
        notes.append(f"calibrated on {len(model.provenance.fitted)} trials: {remaining:.2f} mm over the noise remain")
        notes += [f"warning: the intervals are not reliable: {why}" for why in calibration.warnings]
    trained = False
    with work.adding() as files:
        (files / name).mkdir()
        write_model(model, files / name / MODEL)
    fit = sum(trial.role == "fit" for trial in measured.trials)
    if study.learning.train is not None:
        if fit < study.learning.train_trials:
            notes.append(f"no network: {fit} trials to learn from; expected {study.learning.train_trials}")
        else:
            line, trained = _trained(study, measured, model, work, name, simulators, say)
            notes.append(line)
    say("evaluating the model on the held-out trials")
    held_out = _held_out(study, sets, model_of(work, name), simulators)
    return Learned(
        said=notes,
        trace=traced,
        factors=model.factors,
        effects=[effect.name for effect in model.effects],
        corrector=trained,
        held_out=held_out,
    )


def model_of(work: WorkFolder, name: str) -> Model:
    """Return what was learned in a turn."""
    return read_model(work.folder / name / MODEL)


class Traced(NamedTuple):
    """The verdict, the model with the effects that it has from now on, and lines for people; no model where there was
    too little to trace."""

    verdict: TracedEffects | None
    model: Model | None
    lines: list[str]


def traced_by(
    study: LoopStudy, measured: MeasurementSet, known: Model, out: Path, simulators: Simulators, say: Say
) -> Traced:
    from fabdesign.runtime.fingerprint import OtherContent
    from studies.measured.fit_data import TooLittle
    from studies.tracing import Options, trace_set, verdict_in_words

    learning = study.learning
    trace = partial(
        trace_set,
        measured,
        out,
        inputs=[],
        options=Options(learning.tolerance, learning.trace_grid, study.search.seed, known),
        forward=simulators(learning.trace_grid),
        say=lambda line: say(f"trace: {line}"),
    )
    try:
        try:
            outcome = trace()
        except OtherContent:  # begun with other code: a loop goes on for weeks
            outcome = trace(force=True)
    except TooLittle as error:
        return Traced(None, None, [f"not traced: {error}"])
    traced = TracedEffects(
        verdict=outcome.verdict,
        effects=[effect.name for effect in outcome.effects],
        indistinguishable=[*outcome.indistinguishable],
        excess=plain(outcome.excess_mm),
    )
    return Traced(traced, outcome.model, [f"trace: {verdict_in_words(outcome)}"])


def _calibrated(
    study: LoopStudy, sets: Sequence[MeasurementSet], start: Model, simulators: Simulators, say: Say
) -> Calibration:
    grid = study.points_per_side
    vector = fit_vector(
        [effect.name for effect in start.effects],
        terms=start.terms,
        designs=[design for measured in sets for design in measured.designs.values()],
    )
    return calibrate_sets(
        sets,
        simulators(grid),
        vector=vector,
        progress=lambda line, share: say(f"calibrating: {line}"),
        options=CalibrationOptions(
            slopes=simulators(min(grid, GRID)),
            coarse=simulators(min(grid, GRID)),
            points_per_side=grid,
            seed=study.search.seed,
        ),
    )


def _trained(
    study: LoopStudy,
    measured: MeasurementSet,
    base: Model,
    work: WorkFolder,
    name: str,
    simulators: Simulators,
    say: Say,
) -> tuple[str, bool]:
    """Return what a network is worth, in a line, and whether it is used: the model with it takes the place of the one
    without where it brings the trials kept back nearer, of every design."""
    from studies.training import TrainingOptions, train_on

    assert study.learning.train is not None
    if study.learning.train == "paper":
        import corrector.paper_training  # noqa: F401 loads PyTorch
    with work.adding() as files:
        (files / name).mkdir()
        try:
            result = train_on(
                [measured],
                simulators(study.points_per_side),
                files / name / MODEL,
                TrainingOptions(
                    base,
                    network=study.learning.train,
                    seed=study.search.seed,
                    coarse=simulators(min(study.points_per_side, GRID)),
                ),
                goes_to=work.folder / name / MODEL,
                force=True,
                progress=lambda what, done, total: say(f"training: {what} {done} of {total}"),
            )
        except InputError as error:  # trials that nothing can be learned from
            shutil.rmtree(files / name)
            return f"no network: {error}", False
        shares = [of.closed.surface for of in result.held_out.values() if of.closed.surface is not None]
        used = bool(shares) and min(shares) > 0
        if not used:
            shutil.rmtree(files / name)
    learned = f"network {study.learning.train} learned from {result.learned_from} trials"
    worth = (
        f"removes {min(shares):.0%} of the excess on held-out trials"
        if shares
        else "there was no excess left on held-out trials"
    )
    return f"{learned}, {worth}{'' if used else '; it is not used'}", used


def _held_out(
    study: LoopStudy, sets: Sequence[MeasurementSet], model: Model, simulators: Simulators
) -> dict[str, float] | None:
    """Return the surface excess [mm] on the trials of role test of all sets, before and after as `evaluate` has them;
    None where no frame of such trials is used."""
    grid = study.points_per_side
    try:
        predictor = forward_model(simulators(grid), model)
        errors = evaluate_sets(predictor, sets, coarse=simulators(min(grid, GRID)), seed=study.search.seed).designs
    except InputError:
        return None
    means = {
        state: [Errors(**{name: over.mean for name, over in getattr(of, state).items()}) for of in errors.values()]
        for state in ("before", "after")
    }
    return {state: in_mm(fmean(one.excess for one in each)) for state, each in means.items()}
