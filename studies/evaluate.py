"""How well a model predicts measured motions: errors before and after, per trial and per design."""

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from fabdesign.effort import batches
from fabdesign.errors import InputError, SimulationError
from fabdesign.forward import Case, ForwardModel
from fabdesign.metrics import Closed, Errors, Statistics, closed, statistics, trial_errors
from fabdesign.model import Model
from fabdesign.predictor import Predictor
from fabdesign.sensor_noise import SensorNoise, estimate_noise
from fabdesign.trial import MeasurementSet, Trial
from studies.forward_model import forward_model
from studies.judged import Flags, Judged
from studies.judged_search import judge_sets

_AT_ONCE = 16  # trials, two motions each in memory
_NOISE_FRAMES = 40  # clouds that the sensor noise of a design is estimated from: strays are few
_UNKNOWN = Errors(*[np.nan] * 5)
ERRORS = ("chamfer", "chamfer_floor", "surface_rms", "surface_floor")


@dataclass(frozen=True)
class TrialResult:
    """Errors of one trial's judged frames, m; NaN where the motion diverged, or no frame is judged."""

    set_name: str
    trial: str
    order: int
    role: str
    before: Errors
    after: Errors
    judged: float = 1.0  # share of its frames


@dataclass(frozen=True)
class DesignResult:
    """All trials of one design; the statistics leave out trials that diverged or have no judged frame."""

    source: str  # name and description of the set
    noise: SensorNoise
    trials: tuple[TrialResult, ...]
    before: Mapping[str, Statistics]
    after: Mapping[str, Statistics]
    closed: Closed

    @property
    def diverged(self) -> list[str]:
        lost = (t for t in self.trials if np.isnan(t.before.chamfer) or np.isnan(t.after.chamfer))
        return [t.trial for t in lost if t.judged]

    @property
    def unjudged(self) -> list[str]:
        """Trials without a judged frame."""
        return [t.trial for t in self.trials if not t.judged]


@dataclass(frozen=True)
class Evaluation:
    """designs: trials of role `test`; others: the rest, where they were asked for."""

    designs: Mapping[str, DesignResult]
    others: Mapping[str, DesignResult]
    judged: Judged  # stretches that count for nothing, and their share

    def as_json(self) -> dict[str, Any]:
        """What `evaluate --json` prints: mm."""
        result: dict[str, Any] = {"designs": {name: _as_json(design) for name, design in self.designs.items()}}
        if self.others:
            result["others"] = {name: _as_json(design) for name, design in self.others.items()}
        return result | self.judged.as_json() | {"metric": "chamfer, surface_rms", "unit": "mm"}


def evaluate_sets(
    model: Model,
    sets: Sequence[MeasurementSet],
    forward: ForwardModel,
    *,
    coarse: ForwardModel | None = None,
    all_trials: bool = False,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Evaluation:
    """Errors of `model` on the trials of role `test`, with `all_trials` of the others too, in a table of their own.

    forward: the simulator. coarse: a cheap one with which stretches of these trials are found that hang on less than
    the data sheet knows (studies.judged_search); they count for nothing. Without it they are not looked for. After is
    all of the model; before is what it was without effects and corrector, or, where it has neither, the data sheet.
    `progress` is told trials done and trials in all.
    Raises InputError where no trial is left, or no frame of a design's trials judged; SimulationError where every
    motion of a design diverges.
    """
    before, after = (forward_model(forward, way, sensing=True) for way in (model.before, model))
    shared = Counter(name for found in sets for name in {trial.design_name for trial in found.trials})
    jobs = []
    for found in sets:
        for role in ("test", "fit") if all_trials else ("test",):
            for name in sorted({trial.design_name for trial in found.trials}):
                trials = [t for t in found.trials if t.design_name == name and t.role == role]
                if trials:
                    jobs.append((found, role, name if shared[name] == 1 else f"{found.name}/{name}", trials))
    if not jobs:
        raise InputError(f"{', '.join(s.name for s in sets)}: no trial of role test; --all takes the others too")
    total, done = sum(len(trials) for *_, trials in jobs), 0
    looked_at = judge_sets([(s, [t for found, *_, own in jobs if found is s for t in own]) for s in sets], coarse)
    tables: dict[str, dict[str, DesignResult]] = {"test": {}, "fit": {}}
    for found, role, title, trials in jobs:
        noise = noise_of(trials)
        judge = partial(_errors, noise, seed, partial(looked_at.at, found))
        results: list[TrialResult] = []
        for part in batches([2 * len(trial.times) for trial in trials], _AT_ONCE):
            batch = trials[part]
            motions = _motions(batch, before, after)
            with ThreadPoolExecutor(os.cpu_count()) as threads:  # the search for nearest places runs beside others
                for result in threads.map(judge, [found.name] * len(batch), batch, *motions):
                    results.append(result)
                    done += 1
                    progress(done, total)
        tables[role][title] = _summarise(title, found, noise, results)
    return Evaluation(tables["test"], tables["fit"], looked_at)


def _errors(
    noise: SensorNoise, seed: int, judged: Callable[[Trial], Flags], name: str, trial: Trial, *predicted: Any
) -> TrialResult:
    """Of a trial of the set `name` before and after, whose motions are `predicted`."""
    kept = np.flatnonzero(judged(trial))
    if not len(kept):
        return TrialResult(name, trial.name, trial.order, trial.role, _UNKNOWN, _UNKNOWN, 0.0)
    frames = trial.load().frames
    clouds, seed = [frames[k] for k in kept], seed + trial.order
    before, after = (trial_errors(clouds, motion[kept], noise, seed=seed) for motion in predicted)
    return TrialResult(name, trial.name, trial.order, trial.role, before, after, len(kept) / len(frames))


def noise_of(trials: Sequence[Trial]) -> SensorNoise:
    """The sensor's noise, from frames spread over the trials of a design, the first of each among them: the cloth is
    flattest there."""
    chosen = [trials[i] for i in np.linspace(0, len(trials) - 1, min(len(trials), _NOISE_FRAMES)).astype(int)]
    each = -(-_NOISE_FRAMES // len(chosen))
    frames = []
    for trial in chosen:
        clouds = trial.load().frames
        frames += [clouds[i] for i in np.linspace(0, len(clouds) - 1, min(each, len(clouds))).astype(int)]
    return estimate_noise(frames, trials[0].design.fabric.thickness)


def _motions(trials: Sequence[Trial], *ways: Predictor) -> list[list[Any]]:
    """Of every way, the trials' motions. All ways without a corrector are one batch: it takes two cores no longer."""
    times = [trial.times for trial in trials]
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in trials]
    plain = [way for way in ways if way.corrector is None]
    together = Predictor(ways[0].simulator, sensing=True)
    found = together.motions([way.case(case) for way in plain for case in cases], times * len(plain))
    batches_of = iter(found[k : k + len(trials)] for k in range(0, len(found), len(trials)))
    return [next(batches_of) if way.corrector is None else way.motions(cases, times) for way in ways]


def _summarise(title: str, found: MeasurementSet, noise: SensorNoise, results: Sequence[TrialResult]) -> DesignResult:
    # a trial that either way diverges on is left out of both, so that the two compare
    sound = [r for r in results if np.isfinite(r.before.chamfer) and np.isfinite(r.after.chamfer)]
    if not sound and not any(r.judged for r in results):
        names = ", ".join(r.trial for r in results)
        raise InputError(
            f"{found.name}: {names} of {title}: in every frame small changes lead elsewhere; expected trials whose "
            "pressures say which way the cloth goes"
        )
    if not sound:
        raise SimulationError(f"{found.name}: every motion of {title} diverged")
    before, after = statistics([r.before for r in sound]), statistics([r.after for r in sound])
    means = [Errors(**{name: table[name].mean for name in ERRORS}) for table in (before, after)]
    source = f"{found.name}: {found.description}" if found.description else found.name
    return DesignResult(source, noise, tuple(results), before, after, closed(*means))


def _as_json(design: DesignResult) -> dict[str, Any]:
    def millimetres(table: Mapping[str, Statistics]) -> dict[str, dict[str, float]]:
        distances = {name: {key: 1e3 * x for key, x in asdict(table[name]).items()} for name in ERRORS}
        return distances | {"surface_beyond": asdict(table["beyond"])}

    def errors(values: Errors) -> dict[str, float | None]:
        if np.isnan(values.chamfer):
            return dict.fromkeys((*ERRORS, "surface_beyond"))
        return {name: 1e3 * getattr(values, name) for name in ERRORS} | {"surface_beyond": values.beyond}

    return {
        "before": millimetres(design.before),
        "after": millimetres(design.after),
        "closed": asdict(design.closed) | {"value": design.closed.value},
        "noise": {"sigma_mm": 1e3 * design.noise.sigma, "strays": design.noise.strays},
        "histogram": {error: histogram(design, error) for error in ("chamfer", "surface_rms")},
        "source": design.source,
        "trials": {
            result.trial: {"before": errors(result.before), "after": errors(result.after)} for result in design.trials
        },
        "diverged": design.diverged,
        "without_judged_frame": design.unjudged,
    }


def _values(design: DesignResult, error: str) -> tuple[np.ndarray, np.ndarray]:
    """(trials,) mm before and after, of those that did not diverge."""
    pairs = np.array([(getattr(r.before, error), getattr(r.after, error)) for r in design.trials])
    pairs = 1e3 * pairs[np.isfinite(pairs).all(axis=1)]
    return pairs[:, 0], pairs[:, 1]


def histogram(design: DesignResult, error: str) -> dict[str, list[float]]:
    """Trials per bin of one error: `edges` in mm, counts `before` and `after`."""
    before, after = _values(design, error)
    edges = np.histogram_bin_edges(np.concatenate([before, after]), bins=12)
    counts = {way: np.histogram(x, edges)[0].tolist() for way, x in (("before", before), ("after", after))}
    return {"edges": edges.tolist()} | counts
