"""Where a fit ended, and what is known about it: `Fit`; and how it is kept."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.geometry.surface import CAP
from fabdesign.runtime.store import Arrays, Checkpoint
from optimize.fit.clouds import Array, Match, Sample, frames_of
from optimize.fit.inputs import InputErrors
from optimize.fit.normal import Normal, scatter, step_to_minimum
from optimize.fit.parameters import FitVector
from optimize.fit.problem import Linearisation, Problem


@dataclass(frozen=True, eq=False)
class Fit:
    """The minimum and what is known about it. Vectors and matrices are in the order of `vector`, of x."""

    vector: FitVector
    x: Array  # (p,)
    minimum: Array  # (p,) of the residuals linearised at x: a slight step from x where the fit converged
    covariance: Array  # (p, p)
    before: float  # m, RMS of the residuals capped at 10 mm, at the data sheet
    after: float  # m, the same at the minimum
    by_trial: Array  # (samples,) m, and of each trial; NaN where its motion was lost from the start
    outlying: float  # share of frames that the model misses by far, or has lost
    lost: tuple[tuple[str, float], ...]  # trials whose motion diverged, and from when on [s] they were left out
    iterations: int
    converged: bool
    state: Linearisation  # the residuals and their Jacobian
    normal: Normal  # the normal equations there
    inputs: InputErrors | None = None  # where these are weighed
    without_effects: "Fit | None" = None
    interrupted: bool = False

    @property
    def information(self) -> Array:
        """(p, p) of the data alone, tempered."""
        return self.normal.information

    @property
    def sensitivity(self) -> Array:
        """(p, p) m^2: the mean square change of the residuals, weighted by frame, is v^T sensitivity v."""
        return self.normal.sensitivity

    @property
    def scale(self) -> float:
        """m, robust standard deviation of the residuals."""
        return self.normal.scale


def concluded(
    problem: Problem,
    state: Linearisation,
    inputs: InputErrors | None,
    before: float,
    iterations: int,
    converged: bool,
) -> Fit:
    """The fit that ended at a state."""
    samples, vector, found = problem.samples, problem.vector, state.found
    weight = np.diag(1 / vector.prior**2)
    step, normal = step_to_minimum(samples, state, weight, 0.0, vector, inputs)
    return Fit(
        vector=vector,
        x=state.x,
        minimum=vector.inside(state.x + step),
        covariance=_covariance(normal, weight),
        before=before,
        after=capped(found.residual, found.loss.cap),
        by_trial=np.array([capped(found.residual[found.sample == s], found.loss.cap) for s in range(len(samples))]),
        outlying=_share_outlying(found),
        lost=_lost(samples, found),
        iterations=iterations,
        converged=converged,
        state=state,
        normal=normal,
        inputs=inputs,
    )


def kept(
    checkpoint: Checkpoint,
    named: str,
    problem: Problem,
    compute: Callable[[], Fit],
    inputs: InputErrors | None = None,
) -> Fit:
    """The fit `named` of a problem: that of the checkpoint, else computed and kept. Kept are where it ended, its
    Jacobian, and what errors of the inputs do, unless that is given; the motions there are made again."""
    fresh: list[Fit] = []

    def arrays() -> Arrays:
        fresh.append(found := compute())
        own = {} if inputs is not None or found.inputs is None else vars(found.inputs)
        told = np.array([found.before, found.iterations, found.converged], dtype=float)
        return {"x": found.x, "jacobian": found.state.jacobian, "told": told, **own}

    there = checkpoint.arrays(f"fit_{named}", arrays)
    if fresh:
        return fresh[0]
    if inputs is None and "columns" in there:
        inputs = InputErrors(there["columns"], there["bent"])
    state = problem.with_jacobian(problem.evaluate([there["x"]])[0], there["jacobian"])
    before, iterations, converged = there["told"].tolist()
    return concluded(problem, state, inputs, before, int(iterations), bool(converged))


def _covariance(normal: Normal, weight: Array) -> Array:
    """(p, p), the sandwich; of a likelihood whose observations are capped, its own curvature."""
    bread = np.linalg.inv(normal.information + weight)
    if normal.capped:
        return np.asarray(bread)
    meat = normal.tempering**2 * scatter(normal.scores, normal.information, weight) + weight
    return np.asarray(bread @ meat @ bread)


def capped(residual: Array, cap: float = CAP) -> float:
    """m, RMS of what is not lost."""
    kept = residual[np.isfinite(residual)]
    return float(np.sqrt(np.mean(np.square(np.clip(kept, -cap, cap))))) if len(kept) else float("nan")


def _share_outlying(found: Match) -> float:
    """Share of frames whose median residual is over the loss's `far` times the usual one, or lost."""
    size = np.where(np.isfinite(found.residual), np.abs(found.residual), np.inf)
    medians = np.array([np.median(size[points]) for points in frames_of(found)[1]])
    return float(np.mean(medians > found.loss.far * max(np.median(medians), 1e-30)))


def _lost(samples: Sequence[Sample], found: Match) -> tuple[tuple[str, float], ...]:
    bad = np.isnan(found.residual)
    first = {int(s): float(samples[s].times[found.frame[bad & (found.sample == s)].min()]) for s in found.sample[bad]}
    return tuple((samples[s].trial.name, time) for s, time in sorted(first.items()))
