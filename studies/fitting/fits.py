"""How a study fits models to what was measured: by which engines, how precisely, where fits are kept, who is told; and
where fits of motions begin: at what balances frames of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.registry import EFFECTS
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import ForwardModel, Term
from fabdesign.nouns.predictor import Predictor
from fabdesign.runtime.store import Checkpoint
from optimize.fit.balance import BalanceProblem, acting_in_balance, fit_balance, frames_around
from optimize.fit.descent import FitStart, Progress, fit, parts, silent
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitParameter, FitVector
from optimize.fit.policy import ROUGH, Policy
from optimize.fit.problem import FitProblem
from optimize.fit.relevance import evidence
from optimize.fit.significance import NEEDED, needed
from studies.fitting.fitted_model import expected_rms
from studies.measured.fit_data import MeasuredData


@dataclass(frozen=True, eq=False)
class Fits:
    """How fits are made. tolerance: m of excess that a right model may leave. slopes: a cheaper engine, for
    derivatives and frames in balance. progress_of: the progress of the fit of a name and a vector. last: the policy of
    the last of several fits."""

    forward: ForwardModel
    tolerance: float
    slopes: ForwardModel | None = None
    checkpoint: Checkpoint | None = None
    progress_of: Callable[[str, FitVector], Progress] = lambda named, vector: silent
    last: Callable[[FitVector], Policy] = lambda vector: ROUGH

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
        progress = self.progress_of(named, problem.vector)
        return fit(problem, start, policy, named=named, checkpoint=self.checkpoint, progress=progress)


BALANCED = 16  # trials, of which frames are looked at
KEPT = NEEDED / 2  # of log likelihood: an effect that costs less to drop where a fit begins, is not fitted on
SHOWS = 1e-5  # m RMS that a prior's deviation of an unknown moves frames by; less is rounding


def fit_in_balance(data: MeasuredData, fits: Fits, vector: FitVector) -> Fit | None:
    """Return the fit to frames in balance of what has a tangent of a vector, with next to no doubt of its own: it is
    near, not more. None without such frames, or a tangent of the engine."""
    forward = fits.coarse.forward
    if not isinstance(forward, Predictor) or forward.balancer is None:
        return None
    rng = np.random.default_rng(data.seed)
    every = [frames_around(trial, trial.load(), data.used_of(trial), rng) for trial in data.spread(BALANCED).trials]
    frames = [one for one in every if one is not None]
    if not frames:
        return None
    problem = BalanceProblem(frames, forward, forward.balancer, acting_in_balance(vector), data.noise.sigma)
    named, progress = "in balance" if vector.terms else "factors in balance", fits.progress_of("", vector)

    def say(line: str, share: float) -> None:
        progress(f"{named}, {line}", share)

    return fit_balance(problem, named=named, checkpoint=fits.checkpoint, progress=say)


def starts_of(vector: FitVector, known: Fit | None) -> Array:
    """Return (k, p) where a fit of motions may begin: where another fit is, to first order, without what it does not
    need, or the vector has not got, and where it is with that, each with what it has not got itself at nothing, and at
    its start; and the vector's start."""
    if known is None:
        return vector.start[None]
    off = unneeded(known) | ({*known.vector.labels} - {*vector.labels})
    values = [dict(zip(known.vector.names, x, strict=True)) for x in (known.without(off), known.x)]
    rows = [[of.get(p.name, share * p.start) for p in vector.parameters] for of in values for share in (0.0, 1.0)]
    return np.array([*dict.fromkeys(map(tuple, [*rows, vector.start.tolist()]))])


def worth_fitting(vector: FitVector, balanced: Fit | None) -> set[str]:
    """Return the terms of a vector but those that frames in balance show and have under KEPT of evidence for."""
    if balanced is None:
        return {*vector.labels}
    of = balanced.vector
    score = evidence(balanced, {label: of.part(label) for label in of.labels})
    return {*vector.labels} - {label for label in unneeded(balanced) if score[label] < KEPT}


def unneeded(fit: Fit) -> frozenset[str]:
    """Return the terms that move the residuals of a fit, and that cost under KEPT to drop, one after another."""
    kept = needed(fit.minimum, fit.covariance, fit.vector, KEPT)
    terms = dict(zip(fit.vector.labels, fit.vector.terms, strict=True))
    return frozenset(
        label
        for label in shown(fit)
        if label not in kept and _may_go(terms[label], tuple(fit.vector.parameters[k] for k in fit.vector.part(label)))
    )


def _may_go(term: Term, parameters: Sequence[FitParameter]) -> bool:
    """Return whether a term may be dropped: no model gave it, fitted or held."""
    keys = {parameter.name.rpartition(".")[2] for parameter in parameters}
    return bool(keys) and keys <= {*EFFECTS[term.name].strengths} - term.values.keys()


def shown(fit: Fit) -> list[str]:
    """Return the terms of which an unknown moves the residuals of a fit by more than rounding does."""
    moves = _moves(fit)
    return [label for label in fit.vector.labels if moves[fit.vector.part(label)].any()]


def _moves(fit: Fit) -> NDArray[np.bool_]:
    """Return (p,) which unknowns do."""
    return np.asarray(np.sqrt(np.diag(fit.normal.sensitivity)) * fit.vector.prior > SHOWS)
