"""The grid's own error: what a finer one would change of the residuals, and which of the two a trace runs on.

Cloth that snaps does so elsewhere on another grid: on crossed muscles 21 points a side are up to 2 mm off at the true
factors, which is then taken for something missing. By Richardson's extrapolation, the error falling with the square of
the spacing, a third of what 41 points change of 21 is what 41 still lack, and four thirds are what 21 lack.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fabdesign.forward import ForwardModel
from studies.calibration.clouds import derivatives
from studies.tracing.fit import Bench, State, normal, rows_kept
from studies.tracing.full_fit import Say, fitted
from studies.tracing.stages import Stages
from studies.tracing.vector import Array, Vector

COARSE, FINE = 21, 41  # points a side
ORDER = 2.0  # of the error in the spacing


@dataclass(frozen=True)
class Grid:
    """points_per_side: None, those of the one forward model given. error: m RMS of the residuals, which the declared
    parameters cannot take; None where there is no finer grid to compare with."""

    points_per_side: int | None = None
    error: float | None = None

    def floor(self, noise: float) -> float:
        """m RMS: the noise, and the grid's error with it."""
        return float(np.hypot(noise, self.error or 0.0))


def on_grid(
    bench: Bench,
    stages: Stages,
    state: State,
    finer: ForwardModel | None,
    *,
    tolerance: float,
    refit: Callable[[Bench, Vector, Array], State],
    say: Say,
) -> tuple[Bench, State, Grid]:
    """The grid to go on with, and the refitted state there: `bench`'s own, unless its error, by what the finer
    one changes, is over the tolerance [m]. finer: on FINE points a side, `bench` on COARSE, both through the same
    known effects. refit: descends from a place of a vector."""
    if finer is None:
        return bench, state, Grid()
    changed = float(stages.text("finer_grid", lambda: change(bench, state, finer)))
    error = error_of(changed, finer=False)
    if error <= tolerance:
        return bench, state, Grid(COARSE, error)
    say(f"a grid of {FINE} points a side changes {1e3 * changed:.2f} mm: it is used from here on")
    fine = replace(bench, forward=finer)
    state = fitted(fine, stages, "refit_finer", state.vector, partial(refit, fine, state.vector, state.x))
    changed = float(stages.text("coarser_grid", lambda: change(fine, state, bench.forward)))
    return fine, state, Grid(FINE, error_of(changed, finer=True))


def change(bench: Bench, state: State, other: ForwardModel) -> float:
    """m RMS over the points kept: what another grid changes of the residuals at a state, less what its parameters take
    of that to first order."""
    vector, samples = state.vector, bench.samples
    motions = other.motions([vector.case(s.trial, state.x) for s in samples], [s.times for s in samples])
    moved = derivatives(state.found, [(m - own)[None] for m, own in zip(motions, state.motions, strict=True)])
    column: Array = rows_kept(state, moved)[:, 0]
    own = replace(state, x=np.zeros_like(state.x))  # what the parameters take of it, wherever they are
    hessian = normal(bench, own)[1]
    share = bench.observations / (state.kept.sum() * state.mean_square)
    left = column - state.slopes @ np.linalg.solve(hessian, share * state.slopes.T @ column)
    return float(np.sqrt(np.square(left[state.kept]).mean()))


def error_of(changed: float, *, finer: bool) -> float:
    """m, of the finer or the coarser of two grids, 41 and 21 points a side, from what one changes of the other."""
    ratio = ((FINE - 1) / (COARSE - 1)) ** ORDER
    return changed / (ratio - 1) if finer else changed * ratio / (ratio - 1)
