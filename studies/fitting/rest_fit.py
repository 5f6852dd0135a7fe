"""The fit of shapes at rest: of what acts where a cloth stands, before motions are looked at."""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Jacobians
from fabdesign.nouns.trial import Trial
from optimize.fit.at_rest import RestProblem, Standing, acting_at_rest
from optimize.fit.clouds import evenly
from optimize.fit.descent import fit
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitVector
from optimize.fit.policy import AT_REST
from optimize.fit.rest_detection import standing_of
from studies.fitting.fits import Fits
from studies.measured.fit_data import MeasuredData

TRIALS = 48  # looked at for shapes at rest, at most
SHAPES = 24  # fitted at most
SHOWS = 1e-5  # m RMS that a prior's deviation of an unknown moves shapes by; less is rounding
LEAST = 8  # fewer tell too little of what acts at rest


def shapes_at_rest(trials: Sequence[Trial], noise: float, seed: int) -> list[Standing]:
    """Return shapes at rest of some trials, one for each design and pressures, spread over the session; none where
    there are fewer than LEAST. noise: m, of a point."""
    rng = np.random.default_rng(seed)
    looked_at = [trials[k] for k in evenly(len(trials), TRIALS)]
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
    return np.asarray(np.sqrt(np.diag(fit.sensitivity)) * fit.vector.prior > SHOWS)
