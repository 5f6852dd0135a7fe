"""`fabdesign trace SET`: one trace from a measurement set to its files."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fabdesign.effects import EFFECTS
from fabdesign.effects.registry import check_values, effect_named, effects_of
from fabdesign.errors import InputError
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import POINTS_PER_SIDE, Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import LEAST_TRIALS, MeasurementSet, Trial
from fabdesign.output import work_folder
from fabdesign.runtime.fingerprint import sha256
from fabdesign.runtime.store import Checkpoint
from fabdesign.units import in_mm
from fabdesign.version import SIMULATOR
from optimize.fit.clouds import Density, evenly
from studies.fitting.fits import fit_in_balance, starts_of
from studies.fitting.fitted_model import EXCESS, doubted
from studies.measured.fit_data import MeasuredData, TooLittle
from studies.measured.splits import TRIALS, fit_trials, of_each_design
from studies.measured.used_frames import GRID, find_used_frames
from studies.model_selection.black_box import Residuals, baseline_score
from studies.model_selection.outcome import write_trace
from studies.model_selection.rules import Selection
from studies.model_selection.verdict import Evidence, decide
from studies.tracing.candidates import candidates_of, discover, same_from_rest
from studies.tracing.experiment import Explanation, next_experiment
from studies.tracing.outcome import Outcome, model_of, noise_floor
from studies.tracing.residual_analysis import errors_of_trials, remains
from studies.tracing.selection import every_unknown, select
from studies.tracing.task import Task

ALGORITHM = 33  # of what a trace's folder keeps: raised where kept work is no longer what this code would compute
ELSEWHERE = 2  # trials of a layout that is not fitted
DRAWN = Density(until=6.0, frames=25, points=150)
CALM_STEPS = 12  # time steps in one, far from jumps: within 0.03 mm of 8; at 16 single motions are off by millimetres


@dataclass(frozen=True)
class Options:
    """Options of a trace. tolerance: m of held-out excess within which a model is adequate. grid: points a side; None:
    GRID. model: where the fit starts, and effects that are known already; they stay as they are."""

    tolerance: float = EXCESS
    grid: int | None = None
    seed: int = 0
    model: Model | None = None

    @property
    def known(self) -> Model:
        """Return the model given, or one that says nothing."""
        return self.model or Model()


def trace_set(
    measured: MeasurementSet,
    out: Path | str,
    *,
    inputs: Sequence[Path],
    options: Options = Options(),
    forward: ForwardModel | None = None,
    force: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> Outcome:
    """Trace, and write `trace.json`, `model.toml` and `report.html` into `out`. The same call goes on after a kill.

    inputs: the files and folders read, never written over. forward: the bare simulator, by default with `options.grid`.
    Raises TooLittle for too few trials and OtherContent for a folder of another, both InputErrors.
    """
    trials = fit_trials(measured.trials)
    trials = tuple(trials[i] for i in evenly(len(trials), TRIALS))
    every = (*trials, *(t for t in measured.trials if t.role == "test"))
    _check(options.known)
    with work_folder(out, made_by="trace", force=force, inputs=inputs) as work:
        checkpoint = Checkpoint(work, _content(measured, every, options))
        finer: ForwardModel | None = None
        if forward is None:
            from sim import Simulator  # here: it loads and starts taichi

            forward = Simulator(options.grid or GRID, calm_steps=CALM_STEPS)
            finer = None if options.grid else Simulator(POINTS_PER_SIDE, calm_steps=CALM_STEPS)

        def searching(done: int, total: int) -> None:
            say(f"stretches near a bifurcation: {done} of {total} motions")

        used = find_used_frames([(measured, every)], forward, progress=searching)
        say(used.in_words)
        data = MeasuredData.of([measured], trials, used, DRAWN, seed=options.seed)
        if len(data.trials) < LEAST_TRIALS:
            raise TooLittle(
                f"{measured.name}: {len(data.trials)} trials with frames to use; expected at least {LEAST_TRIALS}"
            )
        known, fitted = options.known, {trial.design_name for trial in data.trials}
        model = Predictor(forward, Model(effects=known.effects), sensing=True)
        task = Task(
            data=data,
            forward=model,
            tolerance=options.tolerance,
            factors=known.factors,
            known=[effect.name for effect in known.effects],
            checkpoint=checkpoint,
            say=say,
            elsewhere=of_each_design([t for t in measured.trials if t.design_name not in fitted], ELSEWHERE),
        )
        outcome = _outcome(task, None if finer is None else replace(model, simulator=finer), every, options)
        from studies.tracing.report import render_report  # here: pages are heavy

        with work.adding() as files:
            write_trace(files, outcome, outcome.model, render_report(outcome))
    return outcome


def _outcome(task: Task, finer: Predictor | None, every: Sequence[Trial], options: Options) -> Outcome:
    """Return what the selection of effects comes to. finer: the model on a finer grid, taken where that matters. every:
    trials fitted, and those of role test, looked at once."""
    data, known, vector = task.data, options.known, every_unknown(task)
    balanced = fit_in_balance(data, task.fits, vector)
    if finer is not None:
        task = task.refined(finer, (vector, starts_of(vector, balanced)[0]))
    grid = options.grid or (GRID if task.slopes is None else POINTS_PER_SIDE)
    selection = select(task, vector, balanced)
    remainder = remains(Residuals.of(data, selection.chosen), selection.folds)
    evidence = _evidence(selection, data, max(remainder.shares.values()))
    verdict = decide(evidence, options.tolerance)
    discovered = discover(task, selection) if verdict == "unexplained" else None
    final = discovered or (selection.judged if verdict == "effect" else selection.before)
    if verdict != "effect" and selection.chosen is not selection.plain:
        remainder = remains(Residuals.of(data, selection.plain), selection.folds)
    task.say("errors before and after, on the trials fitted and once on those of role test")
    errors = errors_of_trials(data, every, task.forward, selection.plain, final.fit)
    candidates, instead = candidates_of(selection)
    if verdict == "effect":
        instead |= same_from_rest(task, selection)
    task.say("what to measure next")
    model = model_of(final.fit, selection, data, points_per_side=grid, known=known.effects)
    named = {}
    if verdict == "effect":
        terms = dict(zip(final.fit.vector.labels, model.effects[len(known.effects) :], strict=True))
        named = {label: terms[label] for label in selection.labels}
    return Outcome(
        verdict=verdict,
        evidence=evidence,
        tolerance=options.tolerance,
        floor=noise_floor(errors, selection.floor),
        selection=selection,
        candidates=candidates,
        named=named,
        indistinguishable=tuple(one.term.name for one in instead.values()) if named else (),
        data=data,
        forward=task.forward,
        alike=tuple(instead.values()),
        errors=tuple(errors),
        remains=remainder,
        model=doubted(model) if verdict == "unexplained" else model,
        next_experiment=_experiment(task, selection, [*instead.values()], verdict),
        final=final,
    )


def _check(model: Model) -> None:
    if model.corrector is not None:
        raise InputError(
            "--model: has a corrector; a trace looks for effects before one is trained, expected a model without"
        )
    for term in model.terms:
        check_values(effect_named(term.name, "--model"), term.values, "--model")


def _evidence(selection: Selection, data: MeasuredData, structure: float) -> Evidence:
    before, after, residuals = selection.before, selection.judged, Residuals.of(data, selection.plain)
    return Evidence(
        before=before.excess,
        after=after.excess,
        effects=len(selection.chosen.vector.labels),
        box_before=baseline_score(residuals, selection.folds).excess(selection.floor),
        structure=structure,
        fitted=residuals.scored.excess(selection.floor),
        typical=before.typical,
        typical_after=after.typical,
        drift=selection.drift,
    )


def _experiment(
    task: Task, selection: Selection, instead: Sequence[Explanation], verdict: str
) -> Mapping[str, Any] | None:
    """Return what tells the model from what else the data leave possible: models with other effects `instead`, else the
    declared parameters alone, and the joint fit. None where the model is adequate and no effect is certain."""
    if verdict == "adequate" and selection.chosen is selection.plain and not selection.small:
        return None
    data = task.data
    fits = {"none": selection.plain, "every effect": selection.everything}
    if selection.chosen is not selection.plain:
        chosen = {" and ".join(effects_of(selection.labels)): selection.chosen}
        fits = chosen if instead else {**chosen, **fits}
    explanations = [Explanation(name, fit.vector, fit.x) for name, fit in fits.items()]
    forward, limits = task.slopes or task.forward, data.sets[0].rig_limits
    return next_experiment(data.trials[0].design, forward, [*explanations, *instead], data.noise.sigma, limits)


def _content(measured: MeasurementSet, trials: Sequence[Trial], options: Options) -> dict[str, str]:
    known = options.known
    content = {f"trial {t.name}": sha256(t.file) for t in trials}
    content |= {f"design {name}": repr(design) for name, design in measured.designs.items()}
    content |= {f"role of {t.name}": t.role for t in trials}
    return content | {
        "--tolerance": f"{in_mm(options.tolerance):g} mm",
        "--grid": str(options.grid or GRID),
        "--seed": str(options.seed),
        "accuracy": repr(measured.accuracy),
        "--model": repr((sorted(known.factors.items()), known.terms)),
        "simulator": str(SIMULATOR),
        "algorithm": str(ALGORITHM),
        "effects": ", ".join(name for name, effect in EFFECTS.items() if effect.named),
    }
