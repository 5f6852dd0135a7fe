"""This module predicts each trial left out from a fit to the others, to first order, with unknowns free or off."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.metrics import over
from fabdesign.nouns.array import Array, Indices
from optimize.fit.fitted import Fit
from optimize.fit.misfit import Misfit, not_strays
from optimize.fit.normal import Normal, whitened
from optimize.fit.problem import InputErrors

_DRAWS = 2000  # of trials, for an interval
Gain = tuple[float, tuple[float, float]]  # m of excess, in quadrature, and 90 %


@dataclass(frozen=True, eq=False)
class Scored:
    """The squares of each trial when it is left out: m^2, weighted sum of squares, and the weights' sum."""

    squares: Array  # (trials,)
    weights: Array  # (trials,)

    def rms(self) -> float:
        """Return the RMS of all trials, m."""
        return float(np.sqrt(self.squares.sum() / max(float(self.weights.sum()), 1e-12)))

    def excess(self, floor: float) -> float:
        """Return the RMS over the noise `floor` [m], in quadrature, m."""
        return over(self.rms(), floor)

    def typical(self, floor: float) -> float:
        """Return the median over trials of the excess of each, m."""
        counts = self.weights > 0
        return over(float(np.sqrt(np.median(self.squares[counts] / self.weights[counts]))), floor)


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A linear model of the residuals about a fit: residual + jacobian @ step.

    folds: (samples,) trials with the same pressures share one. Points count as errors of the inputs leave them.
    """

    misfit: Misfit
    jacobian: Array  # (N, p) m
    x: Array  # (p,)
    prior: Array  # (p,) standard deviations
    normal: Normal
    inputs: InputErrors | None
    folds: Sequence[int]

    @staticmethod
    def of(fit: Fit, folds: Sequence[int]) -> "LeftOut":
        return LeftOut(fit.state.misfit, fit.state.jacobian, fit.x, fit.vector.prior, fit.normal, fit.inputs, folds)

    def with_columns(self, columns: Array, prior: Array) -> "LeftOut":
        """Return the model with more unknowns, which are off. columns: (N, k) m, the change of the residuals by each.
        prior: (k,) their deviations. The points stay the same."""
        return replace(
            self,
            jacobian=np.concatenate([self.jacobian, columns], axis=1),
            x=np.concatenate([self.x, np.zeros(columns.shape[1])]),
            prior=np.concatenate([self.prior, prior]),
        )

    @cached_property
    def kept(self) -> NDArray[np.bool_]:
        """Return which points (N,) are there and not much farther off than the others of their frame."""
        return not_strays(self.misfit) & (self.normal.counts > 0)

    @cached_property
    def residual(self) -> Array:
        """Return the residual (N,) m, cut at the loss's largest, zero where not kept."""
        most = self.misfit.loss.largest
        return np.where(self.kept, np.clip(np.nan_to_num(self.misfit.residual), -most, most), 0.0)

    @cached_property
    def white(self) -> Array:
        """Return the Jacobian (N, p) m less what errors of the inputs can explain of it."""
        return whitened(np.nan_to_num(self.jacobian), self.misfit.block, self.normal, self.inputs)

    @cached_property
    def _parts(self) -> tuple[Array, Array]:
        """Return Hessian (samples, p, p) and gradient (samples, p) by trial, tempered."""
        weighted = self.white * self.normal.weights[:, None]
        residual, jacobian = np.nan_to_num(self.misfit.residual), np.nan_to_num(self.jacobian)
        rows = [np.flatnonzero(self.misfit.sample == s) for s in range(len(self.folds))]
        hessian = np.stack([weighted[r].T @ jacobian[r] for r in rows])
        gradient = np.stack([weighted[r].T @ residual[r] for r in rows])
        return self.normal.tempering * hessian, self.normal.tempering * gradient

    @property
    def information(self) -> Array:
        """Return the information (p, p), tempered, of all trials, with the prior's."""
        hessian = self._parts[0].sum(axis=0)
        return np.asarray(0.5 * (hessian + hessian.T) + np.diag(1 / self.prior**2))

    @property
    def gradient(self) -> Array:
        """Return the gradient (p,), tempered, of all trials, with the prior's."""
        return np.asarray(self._parts[1].sum(axis=0) + self.x / self.prior**2)

    def changing(self, part: Indices, place: Array) -> tuple[Array, Array]:
        """Return (k,) by how much the unknowns `part` (k,) change with the place (samples,) of a trial, beside all
        unknowns, and its covariance (k, k). Its prior is that of `part`."""
        hessian, gradient = self._parts
        once, twice = (np.einsum("s,sij->ij", place**power, hessian) for power in (1, 2))
        within = 0.5 * (twice + twice.T)[np.ix_(part, part)] + np.diag(1 / self.prior[part] ** 2)
        across = 0.5 * (once + once.T)[:, part]
        covariance = np.linalg.inv(np.block([[self.information, across], [across.T, within]]))
        step = -covariance @ np.concatenate([self.gradient, place @ gradient[:, part]])
        return step[-len(part) :], covariance[-len(part) :, -len(part) :]

    def scored(self, off: Indices | Sequence[int] = ()) -> Scored:
        """Return the squares with the unknowns `off` at zero in every fold, the others fitted to the other folds."""
        hessian, gradient = self._parts
        dropped, fold = np.asarray(off, dtype=np.intp), np.asarray(self.folds)
        free = np.setdiff1d(np.arange(len(self.x)), dropped)
        back = np.zeros(len(self.x))
        back[dropped] = -self.x[dropped]
        precision = np.diag(1 / self.prior[free] ** 2)
        squares, weights = np.zeros(len(fold)), np.zeros(len(fold))
        counts, jacobian, most = self.normal.counts, np.nan_to_num(self.jacobian), self.misfit.loss.largest
        several = len(np.unique(fold)) > 1
        for out in np.unique(fold):
            used = fold != out if several else fold == out
            curvature = hessian[used].sum(axis=0)
            slope = gradient[used].sum(axis=0) + curvature @ back
            step = back.copy()
            with_prior = curvature[np.ix_(free, free)] + precision
            step[free] = -np.linalg.solve(with_prior, slope[free] + precision @ self.x[free])
            for s in np.flatnonzero(fold == out):
                rows = np.flatnonzero((self.misfit.sample == s) & self.kept)
                moved = np.clip(self.residual[rows] + jacobian[rows] @ step, -most, most)
                squares[s], weights[s] = counts[rows] @ np.square(moved), counts[rows].sum()
        return Scored(squares, weights)

    def gain(self, worse: Scored, better: Scored, floor: float) -> Gain:
        """Return the excess of `worse` that `better` removes, in quadrature, m, and 90 % by resampling folds."""
        fold = np.asarray(self.folds)
        table = np.array(
            [[a[fold == f].sum() for a in (worse.squares, better.squares, worse.weights)] for f in np.unique(fold)]
        )
        rng = np.random.default_rng(0)
        drawn = table[rng.integers(0, len(table), size=(_DRAWS, len(table)))].sum(axis=1)
        low, high = np.quantile(_taken(drawn, floor), [0.05, 0.95])
        return float(_taken(table.sum(axis=0)[None], floor)[0]), (float(low), float(high))


def _taken(sums: Array, floor: float) -> Array:
    """Return the excess removed, m, negative where the better is worse, by rows of both squares and the weights."""
    worse, better = (np.maximum(sums[:, k] / np.maximum(sums[:, 2], 1e-12) - floor**2, 0.0) for k in (0, 1))
    change = worse - better
    return np.asarray(np.sign(change) * np.sqrt(np.abs(change)))
