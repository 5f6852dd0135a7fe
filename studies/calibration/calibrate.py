"""Calibration: factors on the declared values from measured clouds, with intervals."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fabdesign.errors import InputError
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import POINTS_PER_SIDE, Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.runtime.store import Checkpoint
from optimize.fit.clouds import Density, evenly
from optimize.fit.descent import FitStart, Interrupted, Progress, silent
from optimize.fit.fitted import Fit
from optimize.fit.parameters import DECLARED, FitVector
from optimize.fit.policy import DECLARED_ALONE, ROUGH, Policy
from studies.calibration.result import Calibration, ambiguities
from studies.calibration.trial_checks import implausible
from studies.fitting.fits import Fits, fit_in_balance, starts_of
from studies.fitting.fitted_model import EXCESS, doubted, far_factors, fitted_model, interval_warnings, with_engines
from studies.fitting.joint_fit import MANY, joint_fit
from studies.intervals.calibrate import MOST, with_spread
from studies.measured.fit_data import MeasuredData
from studies.measured.splits import TRIALS, Tolerance, fit_trials, of_each_design
from studies.measured.used_frames import find_used_frames

MOST_TRIALS = 48  # with effects, whose last fit takes 10 CPU s a trial; never more than half of those allowed over 32
DRAWN = Density(until=1.5, frames=30, points=300)
_IN_BALANCE = 0.3  # of the work, where factors alone are fitted
_WITHOUT_EFFECTS = 0.25  # of the work, where effects are fitted after it


@dataclass(frozen=True)
class CalibrationOptions:
    """Options of a calibration. slopes: a cheaper simulator, for derivatives and frames in balance. coarse: a cheap one
    that finds sensitive stretches; they are left out. Without it they are not looked for. points_per_side: of the
    simulator's grid, noted in the model. orders: of the trials fitted; None: those of role `fit`. skipped: lines on bad
    trials left out before; skip_bad: leave out those too that `trial_checks.implausible` finds. engines: (p,) standard
    deviations of the unknowns for the difference between the simulator and what made the data, by default those of the
    virtual rig. intervals: whether those of motions are calibrated too, on the trials of role `fit` that were not
    fitted. interruptible: Ctrl-C ends the fit where its last iteration began, with a warning."""

    slopes: ForwardModel | None = None
    coarse: ForwardModel | None = None
    points_per_side: int = POINTS_PER_SIDE
    orders: Collection[int] | None = None
    skipped: Sequence[str] = ()
    skip_bad: bool = False
    seed: int = 0
    engines: Array | None = None
    intervals: bool = False
    interruptible: bool = False


def calibrate_sets(
    measured: MeasurementSet | Sequence[MeasurementSet],
    forward: ForwardModel,
    *,
    vector: FitVector = DECLARED,
    options: CalibrationOptions = CalibrationOptions(),
    checkpoint: Checkpoint | None = None,
    progress: Progress = silent,
) -> Calibration:
    """Fit the unknowns of `vector`, by default the seven factors of `PARAMETERS`, to all sets and designs together.
    With effects, the factors are fitted without them first, which the model keeps.

    Of more than 16 trials, 16 spread over the session are fitted, and of more than 32 half of them, 48 at most, by the
    last fit of effects: 30 frames of the first 1.5 s of each, and 300 points of a frame. Errors of the pressures and
    the frame's level are weighed by the sets' accuracy. checkpoint: keeps each fit.
    Raises InputError for an implausible trial and where no trial is left, SimulationError where every motion diverges.
    """
    sets = [measured] if isinstance(measured, MeasurementSet) else [*measured]
    _require_names(sets)
    data, slopes = _drawn(sets, vector, options, progress), options.slopes
    sensed = Predictor(forward, sensing=True)
    slopes = slopes and Predictor(slopes, sensing=True)
    fits = Fits(sensed, EXCESS, slopes, checkpoint, lambda named, vector: progress, last=_last)
    fitted, skipped = _fit(data, fits, vector, options), tuple(options.skipped)
    if lines := {} if fitted.interrupted else implausible(fitted, data.samples, sensed):
        tolerance = Tolerance(options.skip_bad, [*skipped])
        for line in lines.values():
            tolerance.note(InputError(line))
        data = data.only([k for k in range(len(data.trials)) if k not in lines])
        skipped = tuple(tolerance.skipped)
        if not data.samples:
            raise InputError(f"{', '.join(s.name for s in sets)}: no trial to fit is left; the first: {skipped[0]}")
        fitted = _fit(data, fits, vector, options)
    covariance = with_engines(fitted, options.engines)
    deviation = np.sqrt(np.diag(covariance))
    why = [*interval_warnings(fitted.after, fitted.outlying, data.noise), *far_factors(fitted)]
    if fitted.interrupted:
        why.append(f"interrupted after {fitted.iterations} iterations, before the best values were reached")
    grid, provenance = options.points_per_side, data.provenance()
    model = fitted_model(fitted, covariance, trials=data.trials, points_per_side=grid, provenance=provenance)
    model, spread_in_words = doubted(model) if why else model, None
    if options.intervals and not fitted.interrupted:
        model, spread_in_words = _with_spread(model, sets, data, forward, options.coarse, progress)
    correlation = covariance / np.outer(deviation, deviation)
    statements = ambiguities(fitted, covariance)
    return Calibration(model, fitted, correlation, statements, tuple(why), skipped, data, spread_in_words)


def _drawn(
    sets: Sequence[MeasurementSet], vector: FitVector, options: CalibrationOptions, progress: Progress
) -> MeasuredData:
    """Return what is fitted of the sets: trials spread over those allowed, less their sensitive stretches."""
    allowed = [trial for one in sets for trial in fit_trials(one.trials, options.orders)]
    chosen = [allowed[i] for i in evenly(len(allowed), most_trials(len(allowed), effects=bool(vector.terms)))]
    files = {trial.file for trial in chosen}
    trials_of_sets = [(one, [t for t in one.trials if t.file in files]) for one in sets]

    def searching(done: int, total: int) -> None:
        progress(f"sensitive stretches: {done} of {total} motions", 0.0)  # before the fit begins

    used = find_used_frames(trials_of_sets, options.coarse, progress=searching)
    return MeasuredData.of(sets, chosen, used, DRAWN, seed=options.seed)


def _last(vector: FitVector) -> Policy:
    """Return how the last fit of a vector goes: last steps of many unknowns gain less than the noise of their
    differences promises, at minutes each."""
    return ROUGH if len(vector.parameters) > MANY else DECLARED_ALONE


def most_trials(allowed: int, *, effects: bool) -> int:
    """Return how many trials are fitted at most. More predict a layout that none of them has better."""
    return max(TRIALS, min(MOST_TRIALS, allowed // 2)) if effects else TRIALS


def _with_spread(
    model: Model,
    sets: Sequence[MeasurementSet],
    data: MeasuredData,
    forward: ForwardModel,
    coarse: ForwardModel | None,
    progress: Progress,
) -> tuple[Model, str | None]:
    """Return the model with intervals of motions from trials of role `fit` that were not fitted, whatever the reason,
    but for those that were found bad, and how good they are; None where there are no such trials."""
    fitted = {trial.file for trial in data.trials}
    others = [t for one in sets for t in one.trials if t.role == "fit" and t.file not in fitted]
    spared = of_each_design(others, MOST)
    if not spared:
        return model, None
    owners = {trial.file: one for one in sets for trial in one.trials}
    used = find_used_frames([(one, [t for t in spared if owners[t.file] is one]) for one in sets], coarse)
    return with_spread(
        model,
        spared,
        forward,
        coarse=coarse,
        used=lambda trial: used.at(owners[trial.file], trial),
        progress=lambda done, total: progress(f"intervals: {done} of {total} trials", 1.0),
    )


def _fit(data: MeasuredData, fits: Fits, vector: FitVector, options: CalibrationOptions) -> Fit:
    """Return the fit. With effects, it begins at the data sheet too: where the fit without them, of TRIALS, ends may be
    far off, in a false minimum. Where that is interrupted, the better of both is kept."""
    plain: Fit | None = None
    try:
        if not vector.terms:
            starts = starts_of(vector, fit_in_balance(data, fits.within(0.0, _IN_BALANCE), vector))
            last = fits.within(_IN_BALANCE, 1.0)
            return last.fit(last.problem(data, vector), FitStart(starts), _last(vector))
        factors, early = vector.without_effects, fits.within(0.0, _WITHOUT_EFFECTS)
        some = data.spread(TRIALS)
        balanced = fit_in_balance(data, early, vector)

        def no_effects(named: str, vector: FitVector) -> Progress:
            return lambda line, share: early.progress_of(named, vector)(f"no effects, {line}", share)

        alone = replace(early, progress_of=no_effects)
        plain = alone.fit(alone.problem(some, factors), FitStart(starts_of(factors, balanced)), _last(factors))
        fitted = joint_fit(data, vector, fits.within(_WITHOUT_EFFECTS, 1.0), balanced)
    except KeyboardInterrupt as stop:
        reached = stop.fit() if options.interruptible and isinstance(stop, Interrupted) else None
        if not options.interruptible or (reached is None and plain is None):
            raise
        if plain is None:
            assert reached is not None
            return reached
        of_all = reached is not None and len(reached.by_trial) == len(data.trials)
        if reached is None or not of_all or reached.after >= _remaining(data, fits, plain, plain.x, plain.after):
            return replace(plain, ended="interrupted")
        fitted = reached
    before = _remaining(data, fits, plain, plain.vector.start, plain.before)
    return replace(fitted, before=before, without_effects=plain)


def _remaining(data: MeasuredData, fits: Fits, plain: Fit, x: Array, known: float) -> float:
    """Return the capped RMS of all trials at x (p,), m. known: of those that `plain` was fitted to."""
    if len(plain.by_trial) == len(data.trials):
        return known
    return fits.problem(data, plain.vector).evaluate([x])[0].misfit.rms


def _require_names(sets: Sequence[MeasurementSet]) -> None:
    """Raise InputError where two sets have one name: trials are told apart as SET/TRIAL."""
    names = [measured.name for measured in sets]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"set {name}: given twice, or two sets have this name; expected a name of its own for each"
            )


def orders_of(text: str) -> list[int]:
    """Return "0,2,5" as numbers. Raises InputError."""
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"--fit {text}: expected orders of trials by comma, such as 0,2,5") from None
