"""Where a fit ended, and what is known about it: `Fit`; and how it is kept."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from fabdesign.nouns.array import Array
from fabdesign.runtime.store import Arrays, Checkpoint
from optimize.fit.clouds import Sample
from optimize.fit.misfit import Misfit, capped, frames_of
from optimize.fit.normal import Normal, scatter, step_to_minimum
from optimize.fit.parameters import FitVector
from optimize.fit.problem import InputErrors, Linearisation, Problem, fingerprint
from optimize.fit.significance import conditioned

# why a fit ended: too many steps; a step that promised next to nothing; more left than another fit would look at
Ending = Literal["iterations", "converged", "hopeless", "interrupted"]
_ENDINGS: tuple[Ending, ...] = get_args(Ending)


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
    ended: Ending
    state: Linearisation  # the residuals and their Jacobian
    normal: Normal  # the normal equations there
    inputs: InputErrors | None = None  # where these are weighed
    without_effects: "Fit | None" = None

    @property
    def converged(self) -> bool:
        """Return whether it ended where a step promised next to nothing."""
        return self.ended == "converged"

    @property
    def interrupted(self) -> bool:
        """Return whether it was ended by Ctrl-C."""
        return self.ended == "interrupted"

    def without(self, labels: Iterable[str]) -> Array:
        """Return (p,) where its unknowns are, to first order, with some of its terms off."""
        there, _ = conditioned(self.minimum, self.covariance, self.vector.parts(labels))
        return self.vector.inside(there)

    def promised(self, there: Array) -> float:
        """Return the RMS of residuals capped at 10 mm, m, to first order, where its unknowns are `there` (p,)."""
        return self.state.after(there - self.x).misfit.rms


def concluded(
    problem: Problem,
    state: Linearisation,
    inputs: InputErrors | None,
    before: float,
    iterations: int,
    ended: Ending,
) -> Fit:
    """Return the fit that ended at a state. before: m RMS, at the data sheet."""
    samples, vector, misfit = problem.samples, problem.vector, state.misfit
    step, normal = step_to_minimum(state, vector, inputs)
    return Fit(
        vector=vector,
        x=state.x,
        minimum=vector.inside(state.x + step),
        covariance=_covariance(normal, vector.precision),
        before=before,
        after=misfit.rms,
        by_trial=np.array([capped(misfit.residual[misfit.sample == s], misfit.loss.cap) for s in range(len(samples))]),
        outlying=_share_outlying(misfit),
        lost=_lost(samples, misfit),
        iterations=iterations,
        ended=ended,
        state=state,
        normal=normal,
        inputs=inputs,
    )


def kept(
    checkpoint: Checkpoint, named: str, problem: Problem, inputs: InputErrors | None, compute: Callable[[], Fit]
) -> Fit:
    """Return the fit `named` of a problem: that of the checkpoint, else computed and kept. Kept are where it ended,
    its Jacobian, and what errors of the inputs do, unless that is given; the motions there are made again."""
    fresh: list[Fit] = []

    def arrays() -> Arrays:
        fresh.append(fit := compute())
        numbers = np.array([fit.before, fit.iterations, _ENDINGS.index(fit.ended)], dtype=float)
        weighed = {} if inputs is not None or fit.inputs is None else vars(fit.inputs)
        return {"x": fit.x, "jacobian": fit.state.jacobian, "told": numbers, **weighed}

    there = checkpoint.arrays(f"fit_{named} {fingerprint(problem.vector, problem.samples)}", arrays)
    if fresh:
        return fresh[0]
    if inputs is None and "columns" in there:
        inputs = InputErrors(there["columns"], there["bent"])
    state = problem.with_jacobian(problem.evaluate([there["x"]])[0], there["jacobian"])
    before, iterations, ended = there["told"].tolist()
    return concluded(problem, state, inputs, before, int(iterations), _ENDINGS[int(ended)])


def _covariance(normal: Normal, weight: Array) -> Array:
    """Return the sandwich (p, p), or the inverse curvature where the likelihood's observations are capped."""
    bread = np.linalg.inv(normal.information + weight)
    if normal.capped:
        return np.asarray(bread)
    meat = normal.tempering**2 * scatter(normal.scores, normal.information, weight) + weight
    return np.asarray(bread @ meat @ bread)


def _share_outlying(misfit: Misfit) -> float:
    """Return the share of frames whose median residual is over the loss's `far` times the usual one, or lost."""
    size = np.where(np.isfinite(misfit.residual), np.abs(misfit.residual), np.inf)
    medians = np.array([np.median(size[points]) for points in frames_of(misfit)[1]])
    return float(np.mean(medians > misfit.loss.far * max(np.median(medians), 1e-30)))


def _lost(samples: Sequence[Sample], misfit: Misfit) -> tuple[tuple[str, float], ...]:
    bad = np.isnan(misfit.residual)
    first = {
        int(s): float(samples[s].times[misfit.frame[bad & (misfit.sample == s)].min()]) for s in misfit.sample[bad]
    }
    return tuple((samples[s].trial.name, time) for s, time in sorted(first.items()))
