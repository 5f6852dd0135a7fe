"""The flexible baseline: a non-parametric regression of a residual, tried on trials that it was not trained on.

Kernel ridge regression of the residual's shapes on the cloth (polynomials of u and v along the front's normal, in bands
from broad to fine) on what drives the motion: pressures, as they are and through lags of several time constants, the
place in the session and the use so far, the model's own shape and its velocity. Each band has the kernel and ridge that
predict it best on trials left out, or none does and it counts as noise. It knows no physics, so a candidate that closes
much less than it does has left structure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.shape import Sheet
from fabdesign.nouns.array import Array, Indices
from fabdesign.nouns.lag import first_order
from optimize.fit.clouds import Match, Sample, places_on_cloth
from optimize.fit.cross_validation import LeftOut, Scored
from optimize.fit.fitted import Fit
from optimize.fit.misfit import frames_of
from studies.measured.fit_data import MeasuredData

BANDS = (0, 3), (4, 5), (6, 7)  # degrees of the polynomials on the cloth
LAGS = 0.05, 0.2, 0.8  # s, of first-order lags of the pressures
SHAPES = 6  # of the model's motion, its main ones
RIDGES = tuple(np.logspace(-3, 2, 6))
WIDTHS = 1.0, 3.0  # of the kernel, times the root of the number of features
MOST_FOLDS = 8  # trained on in turn
_POWERS = [(i, d - i) for d in range(BANDS[-1][1] + 1) for i in range(d + 1)]  # of u and v, by degree


@dataclass(frozen=True, eq=False)
class Residuals:
    """The residuals of a fit as everything that looks at them takes them."""

    samples: Sequence[Sample]
    sheets: Sequence[Sheet]  # the model's motions, a sample each
    misfit: Match
    residual: Array  # (N,) m, zero where not kept
    kept: NDArray[np.bool_]  # (N,) no stray, and the motion is there
    counts: Array  # (N,) how much of what a point says errors of the inputs leave, 0 to 1
    session: Array  # (samples, 3) as the data have it

    @staticmethod
    def of(data: MeasuredData, fit: Fit) -> "Residuals":
        """Return the residuals of a fit to the data, whose sets say what each specimen went through before."""
        linear = LeftOut.of(fit, range(len(data.samples)))
        assert isinstance(linear.misfit, Match)
        return Residuals(
            data.samples, fit.state.sheets, linear.misfit, linear.residual, linear.kept, fit.normal.counts, data.session
        )

    @property
    def scored(self) -> Scored:
        """Return the squares of each trial as it is, fitted."""
        return self.scored_as(self.residual)

    def scored_as(self, residual: Array) -> Scored:
        """Return the squares of each trial with (N,) m in place of the residual."""
        weights = self.counts * self.kept
        squares, sums = np.zeros(len(self.samples)), np.zeros(len(self.samples))
        np.add.at(squares, self.misfit.sample, weights * np.square(residual))
        np.add.at(sums, self.misfit.sample, weights)
        return Scored(squares, sums)


@dataclass(frozen=True, eq=False)
class Frames:
    """Frame by frame: shapes (F, m) m of the residual on the cloth, trial (F,), and for every point its frame and its
    row (N, m) of the shapes' values."""

    shapes: Array
    trial: Indices
    frame: Indices
    basis: Array


def frames_at(state: Residuals) -> Frames:
    """Return the residual of a state as shapes."""
    frame, groups = frames_of(state.misfit)
    basis = basis_of(state)
    shapes, trial = np.zeros((len(groups), basis.shape[1])), np.zeros(len(groups), dtype=int)
    ridge = 1e-2 * np.eye(basis.shape[1])  # a frame of few points says little of its shapes
    for k, points in enumerate(groups):
        rows = points[state.kept[points]]
        b = basis[rows]
        shapes[k] = np.linalg.solve(b.T @ b + ridge, b.T @ state.residual[rows])
        trial[k] = state.misfit.sample[points[0]]
    return Frames(shapes, trial, frame, basis)


def basis_of(state: Residuals) -> Array:
    """Return (N, m): polynomials of the cloth's coordinates at each point's place, along the front's normal, of mean
    square 1 over the cloth."""
    u, v, front = places_on_cloth(state.misfit)
    legendre = np.polynomial.legendre.Legendre.basis
    return np.stack(
        [front * np.sqrt((2 * i + 1) * (2 * j + 1)) * legendre(i)(u) * legendre(j)(v) for i, j in _POWERS], axis=1
    )


def features_of(state: Residuals) -> tuple[Array, ...]:
    """Return groups of (F, k), standardised: pressures, those with the place in the session and the use so far, those
    through lags and the time besides, the model's shape and velocity, and all but the session. Channels that a design
    does not have count as without pressure."""
    channels = max(s.trial.program.pressure.shape[1] for s in state.samples)
    rows, poses = [], []
    for sample, sheet in zip(state.samples, state.sheets, strict=True):
        flat = sheet.middle.reshape(len(sample.times), -1, 3)[:, ::8].astype(float)
        flat = np.nan_to_num(flat.reshape(len(sample.times), -1))
        rate = np.gradient(flat, sample.times, axis=0) if len(flat) > 1 else np.zeros_like(flat)
        rows.append(_driven(sample, channels))
        poses.append((flat, rate))
    driven, shapes, rates = np.concatenate(rows), *(np.concatenate(parts) for parts in zip(*poses, strict=True))
    shape = np.concatenate([_main(shapes), _main(rates)], axis=1)
    session = np.repeat(state.session, [len(sample.times) for sample in state.samples], axis=0)
    aged = np.concatenate([driven[:, :channels], session], axis=1)
    groups = driven[:, :channels], aged, driven, shape, np.concatenate([driven, shape], axis=1)
    return tuple(standardised(group) for group in groups)


def set_points_of(sample: Sample, times: Array, channels: int) -> Array:
    """Return (T, channels) set points of a trial in 100 kPa."""
    pressure = sample.trial.program.at(times) / 1e5
    return np.pad(pressure, ((0, 0), (0, channels - pressure.shape[1])))


def grid_of(sample: Sample) -> tuple[Array, Indices]:
    """Return s, every 0.01 s of a trial, and the place of each of its frames (F,) among them."""
    grid = np.arange(0.0, sample.times[-1] + 0.01, 0.01)
    return grid, np.clip(np.searchsorted(grid, sample.times), 0, len(grid) - 1)


def _driven(sample: Sample, channels: int) -> Array:
    """Return (F, channels (1 + lags) + 2): set points, through lags, their sum and the time."""
    grid, frames = grid_of(sample)
    set_points = set_points_of(sample, grid, channels)
    slow = [lagged(set_points, tau) for tau in LAGS]
    total = set_points.sum(axis=1, keepdims=True)
    return np.asarray(np.concatenate([set_points, *slow, total, np.sqrt(grid)[:, None]], axis=1)[frames])


def lagged(path: Array, tau: float) -> Array:
    """Return a path (k, channels) of one row each 0.01 s through a first-order lag of `tau` [s]."""
    return first_order(path[:-1], np.full(len(path) - 1, 0.01), tau, start=np.zeros(path.shape[1]))


def _main(table: Array) -> Array:
    centred = table - table.mean(axis=0)
    u, s, _ = np.linalg.svd(centred, full_matrices=False)
    return np.asarray((u * s)[:, :SHAPES])


def standardised(table: Array) -> Array:
    spread = table.std(axis=0)
    return np.asarray((table - table.mean(axis=0))[:, spread > 1e-9] / spread[spread > 1e-9])


def baseline_score(state: Residuals, folds: Sequence[int]) -> Scored:
    """Return the squares of each trial's residual less what the baseline predicts of it, trained on the trials of other
    folds. Its kernels and ridges are chosen within those."""
    frames = frames_at(state)
    fold = (np.unique(folds, return_inverse=True)[1] % MOST_FOLDS)[frames.trial]
    bands = [np.array([low <= i + j <= high for i, j in _POWERS]) for low, high in BANDS]
    field = predicted_by_others(features_of(state), frames.shapes, bands, fold)
    return state.scored_as(state.residual - np.einsum("nm,nm->n", frames.basis, field[frames.frame]))


def predicted_by_others(
    features: Sequence[Array], shapes: Array, bands: Sequence[NDArray[np.bool_]], fold: Indices
) -> Array:
    """Return (F, m), the shapes of each fold as those of the others predict them. features: groups of (F, k)."""
    kernels, field = [kernel_of(group, width) for group in features for width in WIDTHS], np.zeros_like(shapes)
    for out in np.unique(fold):
        field[fold == out] = left_out(kernels, shapes, bands, fold, out)
    return field


def left_out(
    kernels: Sequence[Array], shapes: Array, bands: Sequence[NDArray[np.bool_]], fold: Indices, out: int
) -> Array:
    """Return (F_out, m), the shapes of the frames of fold `out`: each band (m,) of them by the kernel and ridge that
    predict it best for each other fold in turn, zero where none does better than nothing.

    A fold's error when it is left out of a ridge regression is that of block leave-one-out: with A = (K + ridge)^-1,
    its A_gg^-1 (A y)_g (Cook and Weisberg 1982, 2.2, by the hat matrix).
    """
    train = np.flatnonzero(fold != out)
    wanted = shapes[train]
    inner = [np.flatnonzero(fold[train] == f) for f in np.unique(fold[train])]
    least = [float(np.square(wanted[:, band]).sum()) for band in bands]
    predicted = np.zeros((int((fold == out).sum()), shapes.shape[1]))
    if len(inner) < 2:
        return predicted
    for kernel in kernels:
        among_trained, other = kernel[np.ix_(train, train)], kernel[np.ix_(fold == out, train)]
        for ridge in RIDGES:
            inverse = np.linalg.inv(among_trained + ridge * np.eye(len(train)))
            weights = inverse @ wanted
            remaining = np.concatenate([np.linalg.solve(inverse[np.ix_(g, g)], weights[g]) for g in inner])
            error = np.square(remaining).sum(axis=0)
            for k, band in enumerate(bands):
                if error[band].sum() < least[k]:
                    least[k] = float(error[band].sum())
                    predicted[:, band] = other @ weights[:, band]
    return predicted


def kernel_of(features: Array, width: float) -> Array:
    """Return the sum of a linear kernel and a Gaussian of the distance."""
    squared = np.square(features).sum(axis=1)
    distance = np.maximum(squared[:, None] + squared - 2 * features @ features.T, 0.0)
    count = max(features.shape[1], 1)
    return np.asarray(0.3 * features @ features.T / count + np.exp(-0.5 * distance / (width**2 * count)) + 0.1)
