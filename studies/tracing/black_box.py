"""The ceiling: what a flexible black box takes of a residual, on trials that it was not trained on.

Kernel ridge regression of the residual's shapes on the cloth (polynomials of u and v along the front's normal) on what
drives the motion: pressures, as they are and through lags of several time constants, the model's own shape and its
velocity. It knows no physics, so a candidate that closes much less than it does has left structure behind.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.pressure import PressureProgram
from studies.calibration.clouds import Indices, frames_of
from studies.tracing.fit import Bench, State
from studies.tracing.vector import Array

DEGREE = 3  # of the polynomials on the cloth
LAGS = 0.05, 0.2, 0.8  # s, of first-order lags of the pressures
SHAPES = 6  # of the model's motion, its main ones
RIDGES = tuple(np.logspace(-3, 2, 6))
WIDTHS = 1.0, 3.0  # of the kernel, times the root of the number of features
_SIDE = 41


@dataclass(frozen=True, eq=False)
class Frames:
    """Frame by frame: shapes (F, m) m of the residual on the cloth, features (F, k), trial (F,), and for every point
    its frame and its row (N, m) of the shapes' values."""

    shapes: Array
    features: Array
    trial: Indices
    frame: Indices
    basis: Array


def frames_at(bench: Bench, state: State) -> Frames:
    """The residual of a state as shapes, and the features of its frames."""
    frame, groups = frames_of(state.found)
    basis = basis_of(state)
    shapes, trial = np.zeros((len(groups), basis.shape[1])), np.zeros(len(groups), dtype=int)
    ridge = 1e-2 * np.eye(basis.shape[1])  # a frame of few points says little of its shapes
    for k, points in enumerate(groups):
        rows = points[state.kept[points]]
        b = basis[rows]
        shapes[k] = np.linalg.solve(b.T @ b + ridge, b.T @ state.residual[rows])
        trial[k] = state.found.sample[points[0]]
    return Frames(shapes, features_of(bench, state), trial, frame, basis)


def basis_of(state: State) -> Array:
    """(N, m): polynomials of the cloth's coordinates at each point's place, along the front's normal."""
    side = state.found.vertex % _SIDE**2
    u = np.einsum("nc,nc->n", state.found.weights, 2 * (side % _SIDE) / (_SIDE - 1) - 1)
    v = np.einsum("nc,nc->n", state.found.weights, 2 * (side // _SIDE) / (_SIDE - 1) - 1)
    front = np.where(state.found.vertex[:, 0] < _SIDE**2, 1.0, -1.0)
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    legendre = np.polynomial.legendre.Legendre.basis
    return np.stack([front * legendre(i)(u) * legendre(j)(v) for i, j in powers], axis=1)


def features_of(bench: Bench, state: State) -> Array:
    """(F, k), standardised; channels that a design does not have count as without pressure."""
    channels = max(s.trial.program.pressure.shape[1] for s in bench.samples)
    rows, poses = [], []
    for sample, motion in zip(bench.samples, state.motions, strict=True):
        pressure = _lagged(sample.trial.program, sample.times, channels)
        middle = 0.5 * (motion[:, : motion.shape[1] // 2 : 8] + motion[:, motion.shape[1] // 2 :: 8])
        flat = np.nan_to_num(np.asarray(middle, dtype=float).reshape(len(motion), -1))
        rate = np.gradient(flat, sample.times, axis=0) if len(flat) > 1 else np.zeros_like(flat)
        rows.append(pressure)
        poses.append(np.concatenate([flat, rate], axis=1))
    pose = np.concatenate(poses)
    half = pose.shape[1] // 2
    main = [_main(pose[:, :half]), _main(pose[:, half:])]
    return _standard(np.concatenate([np.concatenate(rows), *main], axis=1))


def _lagged(program: PressureProgram, times: Array, channels: int) -> Array:
    """(F, channels (1 + lags) + 2): set points, through lags, their sum and the time."""
    grid = np.arange(0.0, times[-1] + 0.01, 0.01)
    told = program.at(grid) / 1e5
    told = np.pad(told, ((0, 0), (0, channels - told.shape[1])))
    parts = [told]
    for tau in LAGS:
        slow, keep = np.zeros_like(told), np.exp(-0.01 / tau)
        for k in range(1, len(grid)):
            slow[k] = keep * slow[k - 1] + (1 - keep) * told[k - 1]
        parts.append(slow)
    all_parts = np.concatenate([*parts, told.sum(axis=1, keepdims=True), np.sqrt(grid)[:, None]], axis=1)
    return np.asarray(all_parts[np.clip(np.searchsorted(grid, times), 0, len(grid) - 1)])


def _main(table: Array) -> Array:
    centred = table - table.mean(axis=0)
    u, s, _ = np.linalg.svd(centred, full_matrices=False)
    return np.asarray((u * s)[:, :SHAPES])


def _standard(table: Array) -> Array:
    spread = table.std(axis=0)
    return np.asarray((table - table.mean(axis=0))[:, spread > 1e-9] / spread[spread > 1e-9])


def ceiling_squares(bench: Bench, state: State, folds: Sequence[int]) -> Array:
    """(samples,) m^2: sums over the points of each trial of the squared residual less what the black box, trained on
    the trials of other folds, takes for it. Its ridge and width are chosen within those."""
    frames = frames_at(bench, state)
    fold = np.asarray(folds)[frames.trial]
    squares = np.zeros(len(bench.samples))
    for out in np.unique(fold):
        predicted = _predict(frames, fold, out)
        rows = np.isin(state.found.sample, np.flatnonzero(np.asarray(folds) == out))
        field = np.zeros((len(fold), frames.shapes.shape[1]))
        field[fold == out] = predicted
        left = state.residual - np.einsum("nm,nm->n", frames.basis, field[frames.frame])
        left = np.where(state.kept, left, 0.0)
        np.add.at(squares, state.found.sample[rows], np.square(left[rows]))
    return squares


def _predict(frames: Frames, fold: Indices, out: int) -> Array:
    """(F_out, m) m, of the held-out frames, by the ridge and width that predict each other fold best."""
    train = fold != out
    inner = np.unique(fold[train])
    best, chosen = np.inf, (RIDGES[-1], WIDTHS[-1])
    for width in WIDTHS:
        kernel = _kernel(frames.features, width)
        for ridge in RIDGES:
            error = 0.0
            for f in inner if len(inner) > 1 else ():
                own, other = train & (fold == f), train & (fold != f)
                error += float(np.square(frames.shapes[own] - _ridge(kernel, frames.shapes, other, own, ridge)).sum())
            if len(inner) > 1 and error < best:
                best, chosen = error, (ridge, width)
    if best > float(np.square(frames.shapes[train]).sum()):
        return np.zeros((int((fold == out).sum()), frames.shapes.shape[1]))  # it knows nothing better
    return _ridge(_kernel(frames.features, chosen[1]), frames.shapes, train, fold == out, chosen[0])


def _kernel(features: Array, width: float) -> Array:
    """Linear, and a Gaussian of the distance."""
    squared = np.square(features).sum(axis=1)
    distance = np.maximum(squared[:, None] + squared - 2 * features @ features.T, 0.0)
    count = features.shape[1]
    return np.asarray(0.3 * features @ features.T / count + np.exp(-0.5 * distance / (width**2 * count)) + 0.1)


def _ridge(kernel: Array, shapes: Array, train: Array, out: Array, ridge: float) -> Array:
    own = kernel[np.ix_(train, train)]
    return np.asarray(kernel[np.ix_(out, train)] @ np.linalg.solve(own + ridge * np.eye(len(own)), shapes[train]))
