"""`fabdesign trace SET`: one trace from a measurement set to its files."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign import SIMULATOR, __version__
from fabdesign.effects import EFFECTS
from fabdesign.effects.registry import check_values, effect_named
from fabdesign.errors import InputError
from fabdesign.forward import PARAMETERS, ForwardModel
from fabdesign.model import Model
from fabdesign.model_file import write_model
from fabdesign.output import WorkFolder, work_folder, write_text
from fabdesign.predictor import Predictor
from fabdesign.splits import fit_trials
from fabdesign.trial import MeasurementSet, Trial
from studies.calibration.clouds import evenly
from studies.calibration.parameters import PRIOR
from studies.judged import Stretch, said, share_unjudged
from studies.judged_search import unjudged
from studies.tracing.data import TRIALS, TooLittle, draw
from studies.tracing.errors import Place, judged_errors
from studies.tracing.experiment import Explanation, next_experiment
from studies.tracing.fit import Bench
from studies.tracing.grid import COARSE, FINE
from studies.tracing.outcome import Outcome, model_of, provenance_of
from studies.tracing.ranking import excess_over
from studies.tracing.residual import remains
from studies.tracing.search import Search, search
from studies.tracing.stages import Stages, sha256
from studies.tracing.vector import FACTORS
from studies.tracing.verdict import Evidence, decide

TOLERANCE = 0.5e-3  # m of excess
LEAST_TRIALS = 3  # with different pressures

Say = Callable[[str], None]
Experiment = Mapping[str, Any] | None


@dataclass(frozen=True)
class Options:
    """tolerance: m of held-out excess within which a model is adequate. grid: points a side; None: COARSE, for a trace
    asks for hundreds of motions, or FINE where that changes too much."""

    tolerance: float = TOLERANCE
    grid: int | None = None
    seed: int = 0


def trace_set(
    measured: MeasurementSet,
    out: Path | str,
    *,
    inputs: Sequence[Path],
    model: Model | None = None,
    options: Options = Options(),
    forward: ForwardModel | None = None,
    force: bool = False,
    say: Say = lambda line: None,
) -> Outcome:
    """Trace, and write `trace.json`, `model.toml` and `report.html` into `out`. The same call goes on after a kill.

    inputs: the files and folders read, never written over. model: where the fit starts, and effects that are known
    already; they stay as they are. forward: the bare simulator, by default with `options.grid`; one that is given
    has no finer grid beside it. Raises TooLittle for too few trials and AnotherTrace for a folder of another, both
    InputErrors.
    """
    trials = fit_trials(measured.trials)
    trials = tuple(trials[i] for i in evenly(len(trials), TRIALS))
    tests = tuple(t for t in measured.trials if t.role == "test")
    known = model or Model()
    _check(known)
    with work_folder(out, made_by="trace", force=force, inputs=inputs) as work:
        stages = Stages(work, _content(measured, (*trials, *tests), known, options))
        if forward is None:
            from sim import Simulator  # here: it loads and starts taichi

            forward = Simulator(options.grid or COARSE)
            finer = None if options.grid else Simulator(FINE)
        else:
            finer = None
        outcome = _trace(measured, trials, tests, known, stages, (forward, finer), options, say)
        _write(work, outcome)
    return outcome


def _trace(
    measured: MeasurementSet,
    trials: tuple[Trial, ...],
    tests: tuple[Trial, ...],
    known: Model,
    stages: Stages,
    grids: tuple[ForwardModel, ForwardModel | None],
    options: Options,
    say: Say,
) -> Outcome:
    """grids: the bare simulator, and that of a finer grid."""
    bare, fine = grids
    effects = Model(effects=known.effects)
    every = (*trials, *tests)
    stretches = _stretches(stages, every, bare, options, say)
    say(said(stretches, share_unjudged(stretches, every)))
    samples, noise = draw(trials, stretches, seed=options.seed)
    if len({id(s.trial) for s in samples}) < LEAST_TRIALS:
        raise TooLittle(f"{measured.name}: {len(samples)} trials with judged frames; expected at least {LEAST_TRIALS}")
    types = sorted({m.type for s in samples for m in s.trial.design.muscles})
    found = search(
        Bench(samples, Predictor(bare, effects, sensing=True)),
        stages,
        noise.sigma,
        tolerance=options.tolerance,
        finer=None if fine is None else Predictor(fine, effects, sensing=True),
        start=_start(known),
        types=types,
        channels=max(s.trial.design.channels for s in samples),
        known=[effect.name for effect in known.effects],
        seed=options.seed,
        say=say,
    )
    bench, forward = found.bench, found.bench.forward
    left = remains(bench, found.after, found.folds)
    evidence = _evidence(found, max(left.shares.values()))
    verdict = decide(evidence, options.tolerance)
    before = Place(found.before.vector, found.before.x)
    after = Place(found.after.vector, found.after.x) if verdict == "effect" else before
    say("errors before and after, on the trials fitted and once on those of role test")
    errors = judged_errors(every, stretches, forward, before, after, noise)
    if verdict != "effect" and found.after is not found.before:
        left = remains(bench, found.before, found.folds)
    say("what to measure next")
    experiment = _experiment(samples[0].trial, forward, found, noise.sigma, verdict)
    hashes = {f"{measured.name}/{t.file.name}": sha256(t.file) for t in trials}
    provenance = provenance_of(measured.name, [s.trial for s in samples], tests, hashes, options.seed)
    grid = found.grid.points_per_side or options.grid or COARSE
    fitted = model_of(found, grid, provenance, with_effects=verdict == "effect", known=known.effects)
    return Outcome(
        name=measured.name,
        synthetic="synthetic" in measured.description,
        verdict=verdict,
        evidence=evidence,
        tolerance=options.tolerance,
        search=found,
        errors=tuple(errors),
        remains=left,
        stretches=stretches,
        share_unjudged=share_unjudged(stretches, every),
        model=fitted,
        next_experiment=experiment,
        said=tuple(_said(found, evidence, options.tolerance)),
    )


def _check(model: Model) -> None:
    if model.corrector is not None:
        raise InputError(
            "--model: has a corrector; a trace looks for effects before one is trained, expected a model without"
        )
    for term in model.terms:
        check_values(effect_named(term.name, "--model"), term.values, "--model")


def _start(model: Model) -> np.ndarray:
    """(7,) prior standard deviations, of the factors that all muscle types share."""
    x = np.zeros(FACTORS)
    for k, name in enumerate(PARAMETERS):
        own = [v for n, v in model.factors.items() if n.split(".")[-1] == name]
        x[k] = np.clip(np.log(np.mean(own)) / PRIOR[name], -4, 4) if own else 0.0
    return x


def _stretches(
    stages: Stages, trials: tuple[Trial, ...], bare: ForwardModel, options: Options, say: Say
) -> tuple[Stretch, ...]:
    kept = stages.text(
        "unjudged",
        lambda: [
            [s.trial, s.begin, s.end]
            for s in unjudged(
                trials, bare,
                progress=lambda done, total: say(f"stretches that hang on a hair: {done} of {total} motions"),
            )
        ],
    )  # fmt: skip
    return tuple(Stretch(str(trial), float(begin), float(end)) for trial, begin, end in kept)


def _evidence(found: Search, left: float) -> Evidence:
    first, last = found.rounds[0], found.rounds[-1]
    return Evidence(
        before=first.ranking.excess,
        after=last.ranking.excess,
        effects=sum(r.chosen is not None for r in found.rounds),
        box_before=first.box,
        box_after=last.box,
        box_certain=first.box_interval90[0] > 0,
        left=left,
        fitted=float(excess_over(found.before.mean_square, found.floor)),
    )


def _experiment(trial: Trial, forward: ForwardModel, found: Search, noise: float, verdict: str) -> Experiment:
    """Between the explanations of the last round that had any."""
    ranked = [r for r in found.rounds if r.finalists]
    if not ranked or verdict == "adequate":
        return None
    explanations = [Explanation(f.name, f.state.vector, f.state.x) for f in ranked[-1].finalists]
    if len(explanations) < 2:
        explanations.append(Explanation("none", found.before.vector, found.before.x))
    return next_experiment(trial.design, forward, explanations, noise)


def _said(found: Search, evidence: Evidence, tolerance: float) -> list[str]:
    lines = []
    first = found.rounds[0]
    certain = [c for c in first.ranking.candidates if first.ranking.certain(c)]
    if evidence.before <= tolerance and certain:
        named = ", ".join(f"{c.effect} ({1e3 * c.gain:.2f} mm)" for c in certain[:3])
        lines.append(f"certain but within the tolerance, so not added: {named}")
    if evidence.before > tolerance and not certain:
        lines.append("no candidate by itself gains more than chance and decoys do")
    if first.chosen is not None and first.chosen.together:
        lines.append(f"found where all effects were fitted at once: {', '.join(first.chosen.effects)}")
    return lines


def _content(measured: MeasurementSet, trials: tuple[Trial, ...], known: Model, options: Options) -> dict[str, str]:
    content = {f"trial {t.name}": sha256(t.file) for t in trials}
    content |= {f"design {name}": repr(design) for name, design in measured.designs.items()}
    content |= {f"role of {t.name}": t.role for t in trials}
    return content | {
        "--tolerance": f"{1e3 * options.tolerance:g} mm",
        "--grid": str(options.grid or "by itself"),
        "--seed": str(options.seed),
        "--model": repr((sorted(known.factors.items()), known.terms)),
        "simulator": str(SIMULATOR),
        "version": __version__,
        "effects": ", ".join(EFFECTS),
    }


def _write(work: WorkFolder, outcome: Outcome) -> None:
    from studies.tracing.report import render_report

    with work.adding() as files:
        write_text(files / "trace.json", json.dumps(outcome.as_json(), indent=1) + "\n")
        write_model(outcome.model, files / "model.toml")
        write_text(files / "report.html", render_report(outcome))
