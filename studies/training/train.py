"""Train a corrector on measured sets, and say what it is worth on trials that it has not seen."""

import importlib.metadata
import platform
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from corrector.field import Regression, load_corrector, write_weights
from fabdesign.files.model_file import write_model
from fabdesign.formats.result_tables import Columns, Tabled
from fabdesign.geometry.metrics import Closed, Errors, closed, mean_errors
from fabdesign.nouns.forward import ForwardModel, Trust
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.output import others_in, work_folder
from fabdesign.runtime.fingerprint import sha256
from fabdesign.runtime.store import Checkpoint
from fabdesign.version import SIMULATOR, __version__
from optimize.fit.parameters import FitVector
from studies.intervals.calibrate import with_spread
from studies.measured.fit_data import noise_of
from studies.measured.used_frames import UsedFrames
from studies.prediction.evaluate import errors_of
from studies.training.data import Chosen, KeptMotions, Progress, TrainingOptions, case_of, choose, fitted_base
from studies.training.networks import train_field, train_paper

ALGORITHM = 18  # of what an unfinished training keeps: raised where it is no longer what this code would compute


@dataclass(frozen=True)
class HeldOutErrors:
    """The errors of a design's trials that took no part, before and after the corrector."""

    trials: int
    trust: Trust
    sheet: Errors | None  # m, means over trials: of the data sheet, where the base is another
    before: Errors
    after: Errors
    closed: Closed  # by the corrector
    json_keys: ClassVar = (
        "trials", "trust.distance",
        ("**", lambda of: {} if of.sheet is None else {"sheet": _millimetres(of.sheet)}),
        ("before", lambda of: _millimetres(of.before)), ("after", lambda of: _millimetres(of.after)), "closed",
    )  # fmt: skip


def _millimetres(errors: Errors) -> dict[str, float]:
    return {name: value for name, value in errors.millimetres().items() if np.isfinite(value)}


@dataclass(frozen=True)
class TrainingResult(Tabled):
    """The result of a training. skipped: bad trials left out, a line each."""

    model: Model
    about: Mapping[str, Any]  # as the weights' file says it
    held_out: Mapping[str, HeldOutErrors]  # by design
    learned_from: int  # trials
    base: str  # what the motions were simulated with
    used: UsedFrames
    intervals: str  # how good they are, or why there are none
    skipped: tuple[str, ...] = ()
    json_keys: ClassVar = (
        "about.network", "base", "learned_from", "about.trust_limit", "about.left_out", "held_out",
        "model.spread", ("**", "used"),
    )  # fmt: skip

    def columns(self) -> Columns:
        """Return errors in mm of each design that was held out: design, trials, then each error before and after."""
        held = self.to_json()["held_out"]
        columns: Columns = {"design": [*held], "trials": [of["trials"] for of in held.values()]}
        for when in ("before", "after"):
            for name in sorted({name for of in held.values() for name in of[when]}):
                columns[f"{name}_{when}"] = [of[when].get(name, np.nan) for of in held.values()]
        return columns


def train_on(
    sets: Sequence[MeasurementSet],
    forward: ForwardModel,
    output: Path,
    options: TrainingOptions,
    *,
    goes_to: Path,
    force: bool = False,
    progress: Progress = lambda what, done, total: None,
) -> TrainingResult:
    """Train on the trials of role `fit` but for those that are held out, and write the model `output` with its weights
    beside it, both named after `goes_to`, where they will lie.

    Work goes on in the folder `goes_to` without its ending plus `.training`, if an earlier call like this one was
    stopped there, and the folder goes when all is done.
    Raises InputError, also for a folder of another training unless `force`, SimulationError where a motion diverges.
    """
    base = options.base.without(["corrector"])
    train_network, plan = _network(options)
    options = replace(options, base=base, plan=plan)
    learned, held, used = choose(sets, options)
    sensed = Predictor(forward, sensing=True)  # what was measured went through the sensors; cases bring their effects
    folder = goes_to.with_suffix(".training")
    with work_folder(folder, made_by="train") as work:
        checkpoint = Checkpoint(work, _content(learned, options), force=force)
        base = fitted_base(sets, learned, options, forward, checkpoint, progress=progress)
        learned, held = ([replace(c, case=case_of(c.trial, base)) for c in side] for side in (learned, held))
        weights, about = train_network(learned, sensed, plan, checkpoint, progress=progress)
        about = dict(about) | {"trained_on": base.central_hash}
        beside = output.with_suffix(".safetensors")
        write_weights(beside, weights, about)
        model = replace(
            base,
            corrector=beside,
            corrector_hash=base.central_hash,
            provenance=_provenance(base, sets, learned, held, options),
        )
        tested = _tested(model, held, KeptMotions(sensed, checkpoint, progress), options.seed) if held else {}
        # neither learned from, nor what the base was fitted to
        judged = {c.trial.file: c.used for c in held if c.name not in model.provenance.fitted}
        model, intervals = with_spread(
            model,
            [chosen.trial for chosen in held if chosen.trial.file in judged],
            forward,
            coarse=options.coarse,
            used=lambda trial: judged[trial.file],
            progress=lambda done, total: progress("intervals", done, total),
        )
        write_model(model, output)
    if next(others_in(folder), None) is None:
        shutil.rmtree(folder)
    return TrainingResult(model, about, tested, len(learned), _in_words(base, options.vector), used, intervals)


def _in_words(base: Model, vector: FitVector | None) -> str:
    """Return what the motions were simulated with."""
    if vector is not None:
        return f"factors{' and effects' * bool(vector.terms)} fitted to the same trials"
    return "the model's parameters" if base.parameters else "the data sheet's parameters"


def _network(options: TrainingOptions) -> tuple[Callable[..., Any], Any]:
    """Return the function that trains, and how."""
    if options.network == "field":
        return train_field, options.plan or Regression(seed=options.seed)
    from corrector.paper_training import PaperTraining

    return train_paper, options.plan or PaperTraining.here(options.seed)


def _content(learned: Sequence[Chosen], options: TrainingOptions) -> dict[str, str]:
    """Return what makes a training the same."""
    return {
        "network": options.network,
        "trials": ", ".join(chosen.name for chosen in learned),
        "unjudged": repr([np.flatnonzero(~chosen.used).tolist() for chosen in learned]),
        "model": options.base.central_hash,
        "points_per_side": str(options.base.points_per_side),
        "free": repr(options.vector),
        "plan": repr(options.plan),
        "files": ", ".join(sha256(chosen.trial.file) for chosen in learned),
        "simulator": str(SIMULATOR),
        "algorithm": str(ALGORITHM),
    }


def _tested(model: Model, held: Sequence[Chosen], motions: KeptMotions, seed: int) -> dict[str, HeldOutErrors]:
    """Return errors on the trials held out, with and without the corrector."""
    corrector = load_corrector(model)
    errors: dict[str, HeldOutErrors] = {}
    for name in sorted({chosen.trial.design_name for chosen in held}):
        of_design = [chosen for chosen in held if chosen.trial.design_name == name]
        noise = noise_of([chosen.trial for chosen in of_design])
        plain, rows = motions.of(of_design), list[list[Errors]]()
        by_sheet = [replace(c, key=f"{c.key}-sheet", case=case_of(c.trial, Model())) for c in of_design]
        declared = motions.of(by_sheet) if model.parameters else None
        wanted = replace(motions, history=corrector.history()).of(of_design)
        for k, (chosen, simple, motion) in enumerate(zip(of_design, plain, wanted, strict=True)):
            trial = chosen.trial
            answer = corrector.correct([chosen.case], [trial.times], [motion])[0]
            kept = np.flatnonzero(chosen.used & (trial.times >= corrector.starts))
            if not len(kept):
                continue
            frames = trial.load().frames
            clouds = [frames[k] for k in kept]
            models = [simple, *(declared[k : k + 1] if declared else []), answer]
            shown = [points[kept] for points in models]
            rows.append(errors_of(trial, clouds, shown, noise, seed=seed, ordered=corrector.ordered))
        if not rows:
            continue
        before, *sheet, after = (mean_errors(each) for each in zip(*rows, strict=True))
        trust = corrector.trust(of_design[0].trial.design)
        errors[name] = HeldOutErrors(
            len(rows), trust, sheet[0] if sheet else None, before, after, closed(before, after)
        )
    return errors


def _provenance(
    base: Model,
    sets: Sequence[MeasurementSet],
    learned: Sequence[Chosen],
    held: Sequence[Chosen],
    options: TrainingOptions,
) -> Any:
    names = ("numpy", "safetensors", *(["torch"] if options.network == "paper" else []))
    origin = base.provenance
    return replace(
        origin,
        sets=tuple(dict.fromkeys([*origin.sets, *(measured.name for measured in sets)])),
        fitted=tuple(dict.fromkeys([*origin.fitted, *(chosen.name for chosen in learned)])),
        held_out=tuple(chosen.name for chosen in held if chosen.name not in origin.fitted),
        versions=dict(origin.versions)
        | {"python": platform.python_version(), "fabdesign": __version__}
        | {name: importlib.metadata.version(name) for name in names},
        seed=origin.seed if origin.seed is not None else options.seed,
    )
