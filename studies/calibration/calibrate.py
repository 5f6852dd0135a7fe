"""Calibration: factors on the declared values from measured clouds, with intervals."""

from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from fabdesign.errors import InputError
from fabdesign.formats.json_file import plain
from fabdesign.formats.result_tables import OfModel
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import POINTS_PER_SIDE, Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.runtime.store import Checkpoint
from fabdesign.units import in_mm
from optimize.fit.clouds import Array, Sample, evenly
from optimize.fit.descent import Progress, fit, parts
from optimize.fit.fitted import Fit, capped, kept
from optimize.fit.parameters import DECLARED, FitVector
from optimize.fit.problem import FitProblem
from studies.calibration.ambiguities import ambiguities
from studies.calibration.fitted_model import fitted_model
from studies.calibration.intervals import EXCESS, excess, expected_rms, far_factors, interval_warnings, with_engines
from studies.calibration.joint_fit import joint_fit
from studies.calibration.rest_fit import fit_at_rest, with_shapes_at_rest
from studies.calibration.trial_checks import DISAGREE, implausible
from studies.intervals.calibrate import chosen as chosen_trials
from studies.intervals.calibrate import spread_json, with_spread
from studies.measured.bad_data import Tolerance
from studies.measured.fit_data import Density, MeasuredData
from studies.measured.sensitive_stretches import find_used_frames
from studies.measured.splits import fit_trials
from studies.measured.used_frames import UsedFrames

TRIALS = 16  # fitted at most without effects, spread over those allowed
MOST_TRIALS = 48  # with effects, whose last fit takes 10 CPU s a trial; never more than half of those allowed over 32
DRAWN = Density(until=1.5, frames=30, points=300)
_MANY = 20  # unknowns, of which last steps gain less than the noise of their differences promises, at minutes each
_CLOSE = 0.1  # of log likelihood, an unknown: a step that promises less, under half a standard deviation, is the last
_WITHOUT_EFFECTS = 0.25  # of the work, where effects are fitted after it


@dataclass(frozen=True, eq=False)
class Calibration(OfModel):
    """What a fit to measurement sets came to."""

    model: Model
    fit: Fit
    correlation: np.ndarray  # (p, p), of the unknowns in the order of fit.vector
    statements: tuple[str, ...]  # what these data do not determine
    warnings: tuple[str, ...]  # why the intervals are not reliable
    skipped: tuple[str, ...]  # bad trials left out, a line each
    data: MeasuredData
    intervals: str | None = None  # how good those of motions are; None: not asked for

    @property
    def used(self) -> UsedFrames:
        """Frames that took part: not those of sensitive stretches."""
        return self.data.used

    @property
    def noise(self) -> SensorNoise:
        return self.data.noise

    def as_json(self) -> dict[str, Any]:
        """What `calibrate --json` prints: factors, mm."""
        parameters = {
            name: {"factor": p.factor, "interval90": p.interval90, "believable": p.reliable}
            for name, p in self.model.parameters.items()
        }
        names = self.fit.vector.names
        content = {
            "parameters": parameters,
            "effects": self.model.effects,
            "correlation": {
                a: dict(zip(names, row, strict=True)) for a, row in zip(names, self.correlation, strict=True)
            },
            "statements": self.statements,
            "believable": not self.warnings,
            "doubts": self.warnings,
            "residual": {"before": in_mm(self.fit.before), "after": in_mm(self.fit.after), "unit": "mm"},
            "excess": {"after": in_mm(excess(self.fit.after, self.noise)), "unit": "mm"},
            "noise": {"sigma": in_mm(self.noise.sigma), "strays": self.noise.strays, "unit": "mm"},
            "fitted": self.model.provenance.fitted,
            "held_out": self.model.provenance.held_out,
            "outlying": self.fit.outlying,
            "lost": [{"trial": trial, "from_s": time} for trial, time in self.fit.lost],
            "skipped": self.skipped,
            "input_accuracy": self.data.accuracy,
            "spread": spread_json(self.model),
            **self.used.as_json(),
            "iterations": self.fit.iterations,
            "converged": self.fit.converged,
            "interrupted": self.fit.interrupted,
        }
        return dict(plain(content))


def calibrate(
    measured: MeasurementSet | Sequence[MeasurementSet],
    forward: ForwardModel,
    *,
    slopes: ForwardModel | None = None,
    coarse: ForwardModel | None = None,
    vector: FitVector = DECLARED,
    points_per_side: int = POINTS_PER_SIDE,
    orders: Collection[int] | None = None,
    skipped: Sequence[str] = (),
    skip_bad: bool = False,
    seed: int = 0,
    engines: np.ndarray | None = None,
    intervals: bool = False,
    interruptible: bool = False,
    checkpoint: Checkpoint | None = None,
    progress: Progress = lambda line, share: None,
) -> Calibration:
    """The unknowns of `vector`, by default the seven factors of `PARAMETERS`, from the trials of role
    `fit`, or those of `orders` of each set; those of all sets and designs together. With effects, the factors are
    fitted without them first, which the model keeps.

    Of more than 16 trials, 16 spread over the session are fitted, and of more than 32 half of them, 48 at most, by the
    last fit of effects: 30 frames of the first 1.5 s of each, and 300 points of a frame, by `seed`. `slopes`: see
    `fit.fit`. coarse: a cheap simulator that finds sensitive stretches (measured.sensitive_stretches); they are left
    out. Without it they are not looked for.
    points_per_side: of `forward`'s grid, noted in the model.
    skipped: lines on bad trials left out before; skip_bad: leave out those too that `trial_checks.implausible` finds.
    engines: (p,) standard deviations of the unknowns for the difference between `forward` and what made the data, by
    default those of the virtual rig.
    Errors of the pressures and the frame's level are weighed by the sets' accuracy.
    intervals: whether those of motions are calibrated too, on the trials of role `fit` that were not fitted.
    interruptible: Ctrl-C ends the fit where its last iteration began, with a warning. checkpoint: keeps the fit of each
    horizon.
    Raises InputError for an implausible trial and where no trial is left, SimulationError where every motion diverges.
    """
    sets = [measured] if isinstance(measured, MeasurementSet) else [*measured]
    _require_names(sets)
    allowed = [trial for one in sets for trial in fit_trials(one.trials, orders)]
    chosen = [allowed[i] for i in evenly(len(allowed), most_trials(len(allowed), effects=bool(vector.terms)))]
    files = {trial.file for trial in chosen}
    own = [(one, [t for t in one.trials if t.file in files]) for one in sets]
    used = find_used_frames(own, coarse, progress=_searching(progress))
    data = MeasuredData.of(sets, chosen, used, DRAWN, seed=seed)
    bare, forward = forward, Predictor(forward, sensing=True)
    slopes = slopes and Predictor(slopes, sensing=True)
    if vector.terms:  # factors alone go by horizons
        data = with_shapes_at_rest(data, allowed)
    fitted = _fit(data, forward, slopes, vector, progress, interruptible, checkpoint)
    if lines := {} if fitted.interrupted else _implausible(fitted, data.samples, forward):
        tolerance = Tolerance(skip_bad, [*skipped])
        for line in lines.values():
            tolerance.note(InputError(line))
        skipped = tolerance.skipped
        data = data.without(lines)
        if not data.samples:
            raise InputError(f"{', '.join(s.name for s in sets)}: no trial to fit is left; the first: {skipped[0]}")
        fitted = _fit(data, forward, slopes, vector, progress, interruptible, checkpoint)
    covariance = with_engines(fitted, engines)
    deviation = np.sqrt(np.diag(covariance))
    why = [*interval_warnings(fitted.after, fitted.outlying, data.noise), *far_factors(fitted)]
    if fitted.interrupted:
        why.append(f"interrupted after {fitted.iterations} iterations, before the best values were reached")
    said = None
    model = fitted_model(
        fitted,
        covariance,
        trials=data.trials,
        reliable=not why,
        points_per_side=points_per_side,
        provenance=data.provenance(),
    )
    if intervals and not fitted.interrupted:
        model, said = _with_spread(model, sets, data, bare, coarse, progress)
    return Calibration(
        model=model,
        fit=fitted,
        correlation=covariance / np.outer(deviation, deviation),
        statements=ambiguities(fitted, covariance),
        warnings=tuple(why),
        skipped=tuple(skipped),
        data=data,
        intervals=said,
    )


def most_trials(allowed: int, *, effects: bool) -> int:
    """How many trials are fitted at most. A layout that none of them has is predicted better by more."""
    return max(TRIALS, min(MOST_TRIALS, allowed // 2)) if effects else TRIALS


def _with_spread(
    model: Model,
    sets: Sequence[MeasurementSet],
    data: MeasuredData,
    forward: ForwardModel,
    coarse: ForwardModel | None,
    progress: Progress,
) -> tuple[Model, str | None]:
    """On trials of role `fit` that were not fitted, whatever the reason, but for those that were found bad; nothing to
    say where there are none."""
    fitted = {trial.file for trial in data.trials}
    spared = chosen_trials([t for one in sets for t in one.trials if t.role == "fit" and t.file not in fitted])
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


def _searching(progress: Progress) -> Callable[[int, int], None]:
    """What the search for sensitive stretches tells: it is done before the fit begins."""
    return lambda done, total: progress(f"sensitive stretches: {done} of {total} motions", 0.0)


def _fit(
    data: MeasuredData,
    forward: ForwardModel,
    slopes: ForwardModel | None,
    vector: FitVector,
    progress: Progress,
    interruptible: bool,
    checkpoint: Checkpoint | None,
) -> Fit:
    """With effects, from the data sheet too: where the fit without them, of TRIALS, ends may be far off, in a false
    minimum. Where that is interrupted, the better of both is kept."""
    reached: deque[Callable[[], Fit]] = deque(maxlen=1)  # makes the fit that ends where this one stands
    plain: Fit | None = None
    early, late = parts(progress, _WITHOUT_EFFECTS)

    def fitted(
        seen: MeasuredData,
        own: FitVector,
        start: Array | None,
        /,
        *,
        named: str = "",
        horizon: float | None = None,
        expected: float,
        progress: Progress,
        jacobian: Array | None = None,
        of: str = "effects",
    ) -> Fit:
        engine = forward if horizon is None or slopes is None else slopes

        def compute() -> Fit:
            reached.clear()
            return fit(
                seen.samples,
                engine,
                slopes=slopes,
                vector=own,
                accuracy=seen.weighed,
                start=start,
                close=_CLOSE * len(own.parameters),
                near=horizon is not None or len(own.parameters) > _MANY,
                jacobian=jacobian,
                expected=expected,
                progress=progress,
                reached=reached.append,
            )

        if checkpoint is None:
            return compute()
        problem = FitProblem(seen.samples, engine, slopes or engine, own)
        return kept(checkpoint, f"{of} of {len(data.trials)} trials {named}", problem, compute)

    def left(plain: Fit, x: Array, seen: float) -> float:
        """m RMS, capped, of all trials at x (p,). seen: of those that `plain` was fitted to."""
        if len(plain.by_trial) == len(data.trials):
            return seen
        return capped(FitProblem(data.samples, forward, forward, plain.vector).evaluate([x])[0].found.residual)

    def beside(plain: Fit, found: Fit) -> Fit:
        return replace(found, before=left(plain, plain.vector.start, plain.before), without_effects=plain)

    try:
        if not vector.terms:
            return fitted(data, vector, None, expected=expected_rms(data.noise), progress=progress)
        factors = vector.without_effects
        alone = partial(fitted, of="factors")
        few = data.only(evenly(len(data.trials), TRIALS).tolist())
        engine = slopes or forward
        rested = [fit_at_rest(data, engine, own, checkpoint=checkpoint, progress=early) for own in (factors, vector)]
        plain = joint_fit(
            few, factors, factors.start, EXCESS, alone, lambda line, share: early(f"no effects, {line}", share),
            at_rest=rested[0],
        )  # fmt: skip
        found = joint_fit(data, vector, vector.start, EXCESS, fitted, late, at_rest=rested[1])
        return beside(plain, found)
    except KeyboardInterrupt:
        if not (interruptible and (reached or plain)):
            raise
        there = [replace(make(), interrupted=True) for make in reached]
        if plain is None:
            return there[0]
        points = sum(len(cloud) for sample in data.samples for cloud in sample.clouds)
        at_last = [found for found in there if len(found.state.found.residual) == points]  # horizons have fewer
        if at_last and at_last[0].after < left(plain, plain.x, plain.after):
            return beside(plain, at_last[0])
        return replace(plain, interrupted=True)


def _implausible(fit: Fit, samples: Sequence[Sample], forward: ForwardModel) -> dict[int, str]:
    """A line for each trial that disagrees with the rest as a recording would whose faces or clock are wrong."""
    if not (fit.by_trial > DISAGREE).any():
        return {}
    return implausible(samples, forward, fit.vector, fit.x)


def _require_names(sets: Sequence[MeasurementSet]) -> None:
    """Raise InputError where two sets have one name: trials are told apart as SET/TRIAL."""
    names = [measured.name for measured in sets]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"set {name}: given twice, or two sets have this name; expected a name of its own for each"
            )


def orders_of(text: str) -> list[int]:
    """ "0,2,5" as numbers. Raises InputError."""
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"--fit {text}: expected orders of trials by comma, such as 0,2,5") from None
