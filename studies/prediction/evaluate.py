"""How well a model predicts measured motions: errors before and after, per trial and per design."""

import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from typing import Any, Literal

import numpy as np

from fabdesign.errors import InputError, SimulationError
from fabdesign.geometry.distances import chamfer
from fabdesign.geometry.metrics import Errors, closed, statistics, trial_errors
from fabdesign.geometry.sensor_noise import SensorNoise, estimate_noise
from fabdesign.nouns.array import Array, Floats
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import MeasurementSet, Role, Trial
from fabdesign.runtime.effort import batches
from optimize.fit.clouds import Motion
from studies.intervals.calibrate import IntervalJudge, interval_judges
from studies.measured.fit_data import noise_clouds
from studies.measured.used_frames import NONE_USED, UsedFrames, find_used_frames
from studies.prediction.evaluation_report import ERRORS, DesignResult, SetEvaluation, TrialResult
from studies.prediction.forward_model import sensed_model

AT_ONCE = 16  # trials, two motions each in memory
_UNKNOWN = Errors(*[np.nan] * 5)


def evaluate_sets(
    predictor: Predictor,
    sets: Sequence[MeasurementSet],
    *,
    coarse: ForwardModel | None = None,
    roles: Sequence[Role] = ("test",),
    seed: int = 0,
    on_interrupt: Literal["raise", "end"] = "raise",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> SetEvaluation:
    """Return errors of a model, by its simulator, on the trials of these roles, those of each in a table of
    their own.

    coarse: a cheap simulator that finds the sensitive stretches of these trials
    (measured.used_frames), which are left out. Without it they are not looked for. After is all of the model;
    before is what it was without effects and corrector, or, where it has neither, the data sheet. A model's intervals
    are evaluated at every sixth frame; coarse moves its drawn models.
    on_interrupt: Ctrl-C is raised, or ends with the trials that are done. `progress` is told trials done and in all.
    Raises InputError where no trial is left, or no frame of a design's trials; SimulationError where every
    motion of a design diverges.
    """
    model, forward = predictor.model, predictor.simulator
    predictors = [sensed_model(forward, model.before), replace(predictor, sensing=True)]
    jobs = _jobs(sets, roles)
    if not jobs:
        raise InputError(f"{', '.join(s.name for s in sets)}: no trial of role test; --all takes the others too")
    used = find_used_frames([(s, [t for job in jobs if job.measured is s for t in job.trials]) for s in sets], coarse)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        jobs = _with_noise(jobs, threads)
        corrector = predictors[-1].corrector
        compare = partial(errors_of, seed=seed, ordered=corrector is None or corrector.ordered)
        tasks = [(partial(_errors, job, used, compare), trial) for job in jobs for trial in job.trials]
        results: list[TrialResult] = []
        try:
            for task in _evaluated(tasks, predictors, coarse or forward, threads):
                results.append(task.result())
                progress(len(results), len(tasks))
        except KeyboardInterrupt:
            if on_interrupt == "raise" or not results:
                raise
            begins = np.cumsum([0, *(len(job.trials) for job in jobs[:-1])])
            jobs = jobs[: int((begins < len(results)).sum())]
    tables: dict[str, dict[str, DesignResult]] = {"test": {}, "fit": {}}
    for job in jobs:
        of_set, results = results[: len(job.trials)], results[len(job.trials) :]
        tables[job.role][job.title] = _summarise(job, of_set)
    return SetEvaluation(tables["test"], used, tables["fit"], model.unreliable)


@dataclass(frozen=True)
class _Job:
    """The trials of one design and role of a set: a row of a table. noise: theirs, being estimated."""

    measured: MeasurementSet
    role: str
    title: str
    trials: Sequence[Trial]
    noise: "Future[SensorNoise]" = field(default_factory=Future)


def _jobs(sets: Sequence[MeasurementSet], roles: Sequence[Role]) -> list[_Job]:
    names = [sorted({trial.design_name for trial in measured.trials}) for measured in sets]
    shared = Counter(chain.from_iterable(names))
    return [
        _Job(measured, role, name if shared[name] == 1 else f"{measured.name}/{name}", trials)
        for measured, some in zip(sets, names, strict=True)
        for role in roles
        for name in some
        if (trials := [t for t in measured.trials if t.design_name == name and t.role == role])
    ]


def _with_noise(jobs: Sequence[_Job], threads: ThreadPoolExecutor) -> list[_Job]:
    """Return the jobs, each with its noise; what one set has of cloths of one thickness was seen by one sensor, and is
    estimated once."""
    alike: dict[tuple[int, float], list[Trial]] = {}
    sensors = [(id(job.measured), job.trials[0].design.fabric.thickness) for job in jobs]
    for job, sensor in zip(jobs, sensors, strict=True):
        alike.setdefault(sensor, []).extend(job.trials)
    noises = {one: threads.submit(estimate_noise, noise_clouds(trials), one[1]) for one, trials in alike.items()}
    return [replace(job, noise=noises[sensor]) for job, sensor in zip(jobs, sensors, strict=True)]


def _evaluated(
    tasks: Sequence[tuple[Callable[..., TrialResult], Trial]],
    predictors: Sequence[Predictor],
    coarse: ForwardModel,
    threads: ThreadPoolExecutor,
) -> Iterator["Future[TrialResult]"]:
    """Yield every trial's result, in order. The motions of a batch are simulated while those before are evaluated.
    Files are read here, not beside the simulator: Python 3.11 may fail where two threads parse (gh-106905), as numpy
    does for an array's header and Taichi for a kernel."""
    waiting: list[Future[TrialResult]] = []
    for part in batches([2 * len(trial.times) for _, trial in tasks], AT_ONCE):
        trials = [trial for _, trial in tasks[part]]
        motions = _motions(trials, *predictors)
        judges = interval_judges(trials, predictors[-1], coarse, motions[-1])
        due, waiting = waiting, []
        for (errors, trial), judge, *predicted in zip(tasks[part], judges, *motions, strict=True):
            waiting.append(threads.submit(errors, trial, trial.load().frames, judge, *predicted))
        yield from due
    yield from waiting


def _errors(
    job: _Job,
    used: UsedFrames,
    compare: Callable[..., list[Errors]],
    trial: Trial,
    frames: Sequence[Array],
    judge: IntervalJudge,
    *predicted: Any,
) -> TrialResult:
    """Return the errors of a trial with these clouds before and after; its motions are `predicted`."""
    kept, judged = np.flatnonzero(used.at(job.measured, trial)), None
    before, after = _UNKNOWN, _UNKNOWN
    if len(kept):
        clouds, motions = [frames[k] for k in kept.tolist()], [motion[kept] for motion in predicted]
        before, after = compare(trial, clouds, motions, job.noise.result())
        judged = judge(frames, kept)
    about = job.measured.name, trial.name, trial.design.name, trial.order, trial.role
    return TrialResult(*about, before, after, len(kept) / len(frames), judged)


def errors_of(
    trial: Trial,
    clouds: Sequence[Array],
    motions: Sequence[Motion],
    noise: SensorNoise,
    *,
    seed: int = 0,
    ordered: bool = True,
) -> list[Errors]:
    """Return the errors of several models on some frames of a trial, with the same draws for their floors. clouds: k of
    (n, 3) m; motions: (k, 2 n, 3) m of each model. ordered: whether the last model's points have an order; without one
    they have no surface, and their floor is that of the first model's."""
    surfaces = motions if ordered else motions[:-1]
    errors = [trial_errors(clouds, motion, noise, seed=seed + trial.order) for motion in surfaces]
    return errors if ordered else [*errors, unordered_errors(clouds, motions[-1], errors[0].chamfer_floor)]


def unordered_errors(clouds: Sequence[Floats], answer: Motion, chamfer_floor: float) -> Errors:
    """Return the errors [m] of an answer without an order. chamfer_floor: of the simulated surface."""
    if not np.isfinite(answer).all():
        return _UNKNOWN
    apart = float(np.mean([chamfer(cloud, points) for cloud, points in zip(clouds, answer, strict=True)]))
    return Errors(apart, chamfer_floor, np.nan, np.nan, np.nan)


def _motions(trials: Sequence[Trial], *predictors: Predictor) -> list[list[Any]]:
    """Return the trials' motions by every predictor. All without a corrector are one batch: it takes two cores no
    longer."""
    times = [trial.times for trial in trials]
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in trials]
    plain = [predictor for predictor in predictors if predictor.corrector is None]
    together = Predictor(predictors[0].simulator, sensing=True)
    motions = together.motions([predictor.case(case) for predictor in plain for case in cases], times * len(plain))
    batches_of = iter(motions[k : k + len(trials)] for k in range(0, len(motions), len(trials)))
    return [next(batches_of) if p.corrector is None else p.motions(cases, times) for p in predictors]


def _summarise(job: _Job, results: Sequence[TrialResult]) -> DesignResult:
    measured, title = job.measured, job.title
    # a trial on which either diverges is left out of both, so that the two compare
    sound = [r for r in results if np.isfinite(r.before.chamfer) and np.isfinite(r.after.chamfer)]
    if not sound and not any(r.used for r in results):
        names = ", ".join(r.trial for r in results)
        raise InputError(f"{measured.name}: {names} of {title}: {NONE_USED}")
    if not sound:
        raise SimulationError(f"{measured.name}: every motion of {title} diverged")
    before, after = statistics([r.before for r in sound]), statistics([r.after for r in sound])
    means = [Errors(**{name: table[name].mean for name in ERRORS}) for table in (before, after)]
    source = f"{measured.name}: {measured.description}" if measured.description else measured.name
    return DesignResult(source, job.noise.result(), tuple(results), before, after, closed(*means))
