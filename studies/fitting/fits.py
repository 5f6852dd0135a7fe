"""How a study fits models to what was measured: by which engines, how precisely, where fits are kept, who is told;
and the fit of shapes at rest: of what acts where a cloth stands, before motions are looked at."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Jacobians
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.trial import Trial
from fabdesign.runtime.store import Checkpoint
from optimize.fit.at_rest import RestProblem, Standing, acting_at_rest, standing_of
from optimize.fit.clouds import evenly
from optimize.fit.descent import FitStart, Progress, fit, parts, silent
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitVector
from optimize.fit.policy import AT_REST, ROUGH, Policy
from optimize.fit.problem import FitProblem
from studies.fitting.fitted_model import expected_rms
from studies.measured.fit_data import MeasuredData


@dataclass(frozen=True, eq=False)
class Fits:
    """How fits are made. tolerance: m of excess that a right model may leave. slopes: a cheaper engine, for first steps
    and derivatives. progress_of: the progress of the fit of a name and a vector. named: before the names of fits in the
    checkpoint. last: the policy of the last of several fits. patient: whether a joint fit begins again wherever a
    horizon leaves more than a right model, not the first alone where that is far more."""

    forward: ForwardModel
    tolerance: float
    slopes: ForwardModel | None = None
    checkpoint: Checkpoint | None = None
    progress_of: Callable[[str, FitVector], Progress] = lambda named, vector: silent
    named: str = ""
    last: Callable[[FitVector], Policy] = lambda vector: ROUGH
    patient: bool = False

    @property
    def coarse(self) -> "Fits":
        """Return the same by the cheaper engine alone."""
        return replace(self, forward=self.slopes or self.forward)

    def within(self, begin: float, end: float) -> "Fits":
        """Return the same as a part of the work, by the shares of it at which it begins and ends."""
        return replace(self, progress_of=lambda named, vector: parts(self.progress_of(named, vector), begin, end)[1])

    def problem(self, data: MeasuredData, vector: FitVector, expected: float | None = None) -> FitProblem:
        """Return the motions of some data. expected: m RMS that a right model leaves at most; None: without any effect
        what the tolerance allows, while effects that begin at nothing leave much before they are found."""
        if expected is None:
            expected = np.inf if vector.terms else expected_rms(data.noise, self.tolerance)
        return FitProblem(data.samples, self.forward, self.slopes or self.forward, vector, data.weighed, expected)

    def fit(self, problem: FitProblem, start: FitStart, policy: Policy, named: str = "") -> Fit:
        """Return the fit of a name, kept or computed."""
        named = f"{self.named} {named}".strip()
        progress = self.progress_of(named, problem.vector)
        return fit(problem, start, policy, named=named, checkpoint=self.checkpoint, progress=progress)


SHAPES = 24  # fitted at most, of twice as many trials
SHOWS = 1e-5  # m RMS that a prior's deviation of an unknown moves shapes by; less is rounding
LEAST = 8  # fewer tell too little of what acts at rest


def shapes_at_rest(trials: Sequence[Trial], noise: float, seed: int) -> list[Standing]:
    """Return shapes at rest of some trials, one for each design and pressures, spread over the session; none where
    there are fewer than LEAST. noise: m, of a point."""
    rng = np.random.default_rng(seed)
    looked_at = [trials[k] for k in evenly(len(trials), 2 * SHAPES)]
    shapes = [one for trial in looked_at for one in standing_of(trial, trial.load(), noise, rng)]
    unlike = [*{(one.sample.trial.design_name, *one.pressure.tolist()): one for one in reversed(shapes)}.values()]
    if len(unlike) < LEAST:
        return []
    return [unlike[k] for k in evenly(len(unlike), SHAPES)]


def with_shapes_at_rest(data: MeasuredData, trials: Sequence[Trial]) -> MeasuredData:
    """Return the data with shapes at rest of trials that may be fitted."""
    return replace(data, standing=tuple(shapes_at_rest(trials, data.noise.sigma, data.seed)))


def fit_at_rest(data: MeasuredData, fits: Fits, vector: FitVector) -> Fit | None:
    """Return the fit to shapes of what acts at rest of a vector; None without shapes, or a tangent of the engine."""
    jacobians: Jacobians | None = getattr(fits.coarse.forward, "faces_jacobian", None)
    if not data.standing or jacobians is None:
        return None
    named, progress = "at rest" if vector.terms else "factors at rest", fits.progress_of("", vector)
    problem = RestProblem(data.standing, jacobians, acting_at_rest(vector), data.weighed)
    return fit(
        problem,
        policy=AT_REST,
        named=named,
        checkpoint=fits.checkpoint,
        progress=lambda line, share: progress(f"{named}, {line}", share),
    )


def beginning(vector: FitVector, at_rest: Fit, dropped: Collection[str]) -> Array:
    """Return (p,) where a fit of motions begins: what shapes at rest say of an unknown that shows there, with the terms
    `dropped` at nothing, or its start."""
    there = at_rest.without(dropped) if dropped else at_rest.x
    known = {name: x for name, x, k in zip(at_rest.vector.names, there, _moves(at_rest), strict=True) if k}
    return np.array([known.get(p.name, p.start) for p in vector.parameters])


def shown(fit: Fit) -> list[str]:
    """Return the terms of which an unknown moves the residuals of a fit by more than rounding does."""
    moves = _moves(fit)
    return [label for label in fit.vector.labels if moves[fit.vector.part(label)].any()]


def _moves(fit: Fit) -> NDArray[np.bool_]:
    """Return (p,) which unknowns do."""
    return np.asarray(np.sqrt(np.diag(fit.normal.sensitivity)) * fit.vector.prior > SHOWS)
