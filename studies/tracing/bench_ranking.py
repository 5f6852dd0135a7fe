"""Ranking by cross-validation over whole records of a bench: linear algebra on each trial's Gram matrix.

At a state the residual is r + J d + C b: declared parameters d, a candidate's columns b, each with its prior. What one
trial says of all of them is its Gram matrix of [J C r]; folds, bootstraps and null distributions need no more.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FLIPS = 200  # sign vectors of the null at most
BOOTSTRAP = 2000  # draws of trials
CHANCE = 0.99  # quantile of the best of all candidates' gain by chance, above which one is certain
_ROUNDS = 3  # of the noise's size against the fit


@dataclass(frozen=True)
class Variant:
    """A candidate at one shape: columns that are taken together."""

    effect: str
    columns: tuple[int, ...]
    deviation: float  # of the columns' coefficients, by the prior
    shape: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Grams:
    """gram: (units, k + 1, k + 1) of [J C r], k = parameters + columns; a unit is a trial, or half of one.
    trial: (units,) which. points: (units,) how many are kept. precision: (parameters,) of the prior, x: where the
    parameters are. observations: what all points are taken for."""

    gram: Array
    trial: NDArray[np.intp]
    fold: NDArray[np.intp]  # (units,) trials with the same pressures share one
    points: Array
    precision: Array
    x: Array
    observations: float

    @property
    def parameters(self) -> int:
        return len(self.x)

    @property
    def mean_square(self) -> float:
        """m^2, of the residual as it is."""
        return float(self.gram[:, -1, -1].sum() / self.points.sum())


@dataclass(frozen=True, eq=False)
class BenchScore:
    """A candidate cross-validated. squares: (units,) m^2, sums over each unit's points when it is held out."""

    variant: Variant | None  # None: nothing is added
    squares: Array
    coefficients: Array  # of its columns, fitted to all trials


def cross_validate(grams: Grams, variant: Variant | None) -> BenchScore:
    """Every fold predicted from the others, the declared parameters fitted along."""
    squares, everywhere = _left_out(grams, variant, np.ones((1, len(grams.points))))
    return BenchScore(variant, squares[0], everywhere[0, grams.parameters :])


def _left_out(grams: Grams, variant: Variant | None, signs: Array) -> tuple[Array, Array]:
    """(s, units) squares as in BenchScore, and (s, k) steps fitted to all trials, where the residual of each unit is
    turned by its sign in each row of `signs` (s, units)."""
    columns = [*range(grams.parameters), *((grams.parameters + c for c in variant.columns) if variant else ())]
    precision, centre = grams.precision, grams.x
    if variant is not None:
        more = len(variant.columns)
        precision = np.concatenate([precision, np.full(more, 1 / variant.deviation**2)])
        centre = np.concatenate([centre, np.zeros(more)])
    a = grams.gram[(slice(None), *np.ix_(columns, columns))]
    g = signs[:, :, None] * grams.gram[:, columns, -1]
    squares = np.empty(signs.shape)
    for fold in np.unique(grams.fold):
        out = grams.fold == fold
        step = _solve(a[~out].sum(axis=0), g[:, ~out].sum(axis=1), grams, ~out, precision, centre)
        quadratic = np.einsum("si,uij,sj->su", step, a[out], step, optimize=True)
        squares[:, out] = quadratic + 2 * np.einsum("sui,si->su", g[:, out], step) + grams.gram[out, -1, -1]
    every = np.ones(len(grams.points), dtype=bool)
    return np.maximum(squares, 0.0), _solve(a.sum(axis=0), g.sum(axis=1), grams, every, precision, centre)


def _solve(a: Array, g: Array, grams: Grams, used: NDArray[np.bool_], precision: Array, centre: Array) -> Array:
    """(s, k) steps to the minimum for gradients g (s, k), the noise being as large as what each leaves."""
    points = grams.points[used].sum()
    before = grams.gram[used, -1, -1].sum() / points
    size, step = np.full(len(g), before), np.zeros_like(g)
    for _ in range(_ROUNDS):
        share = grams.observations / (grams.points.sum() * np.maximum(size, 1e-12))
        left = share[:, None, None] * a + np.diag(precision)
        step = -np.linalg.solve(left, (share[:, None] * g + precision * centre)[:, :, None])[:, :, 0]
        change = np.einsum("si,ij,sj->s", step, a, step, optimize=True) + 2 * (g * step).sum(axis=1)
        size = np.maximum(before + change / points, 0.05 * before)
    return step


@dataclass(frozen=True, eq=False)
class BenchCandidate:
    """An effect at its best variant. held_out: m RMS when trials are left out in turn; gain: m of excess that it takes
    from that of `none`; interval90 of the gain by resampling trials."""

    effect: str
    best: BenchScore
    held_out: float
    gain: float
    interval90: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Ranking:
    none: BenchScore
    none_held_out: float  # m RMS
    candidates: tuple[BenchCandidate, ...]  # best first
    chance: float  # m of gain that the best of all candidates reaches where there is none, in 99 of 100 cases
    excess: float  # m, held out, without any

    def certain(self, candidate: BenchCandidate) -> bool:
        """Whether it gains what chance does not."""
        return candidate.gain > self.chance and candidate.interval90[0] > 0


def rank(grams: Grams, variants: Sequence[Variant], floor: float, *, seed: int = 0) -> Ranking:
    """floor: m, RMS of the sensor's noise in the residuals."""
    none = cross_validate(grams, None)
    scored = {id(v): cross_validate(grams, v) for v in variants}
    rng = np.random.default_rng(seed)
    candidates = []
    for effect in dict.fromkeys(v.effect for v in variants):
        own = [scored[id(v)] for v in variants if v.effect == effect]
        best = min(own, key=lambda s: s.squares.sum())
        candidates.append(
            BenchCandidate(
                effect,
                best,
                held_out(grams, best),
                excess_of(grams, none, floor) - excess_of(grams, best, floor),
                gain_interval(grams, none, best, floor, rng),
            )
        )
    before = excess_of(grams, none, floor)
    return Ranking(
        none,
        held_out(grams, none),
        tuple(sorted(candidates, key=lambda c: c.held_out)),
        _chance(grams, variants, floor, rng),
        before,
    )


def held_out(grams: Grams, scored: BenchScore) -> float:
    """m RMS."""
    return float(np.sqrt(scored.squares.sum() / grams.points.sum()))


def excess_of(grams: Grams, scored: BenchScore, floor: float) -> float:
    return float(excess_over(scored.squares.sum() / grams.points.sum(), floor))


def excess_over(mean_square: Array | float, floor: float) -> Array:
    """m, of a mean square [m^2] over the noise [m], in quadrature."""
    return np.sqrt(np.maximum(np.asarray(mean_square) - floor**2, 0.0))


def gain_interval(
    grams: Grams, worse: BenchScore, better: BenchScore, floor: float, rng: np.random.Generator
) -> tuple[float, float]:
    """90 %, m of excess, resampling folds."""
    folds = np.unique(grams.fold)
    sums = np.array([[x[grams.fold == f].sum() for x in (worse.squares, better.squares, grams.points)] for f in folds])
    drawn = sums[rng.integers(0, len(folds), size=(BOOTSTRAP, len(folds)))].sum(axis=1)
    gains = excess_over(drawn[:, 0] / drawn[:, 2], floor) - excess_over(drawn[:, 1] / drawn[:, 2], floor)
    low, high = np.quantile(gains, [0.05, 0.95])
    return float(low), float(high)


def _chance(grams: Grams, variants: Sequence[Variant], floor: float, rng: np.random.Generator) -> float:
    """m: the CHANCE quantile of the largest gain of all variants where the residual of each unit has a sign by chance,
    so that nothing in it agrees from trial to trial (wild bootstrap, Liu 1988)."""
    signs, points = sign_vectors(len(grams.points), rng), grams.points.sum()
    if not len(signs) or not variants:
        return 0.0
    least = [excess_over(_left_out(grams, v, signs)[0].sum(axis=1) / points, floor) for v in variants]
    before = excess_over(_left_out(grams, None, signs)[0].sum(axis=1) / points, floor)
    return float(np.quantile(before - np.min(least, axis=0), CHANCE))


def sign_vectors(count: int, rng: np.random.Generator) -> Array:
    """(n, count) of +1 and -1, the first +1, without the one that changes nothing: all, or FLIPS by chance."""
    if 2 ** (count - 1) <= FLIPS:
        every = np.array([(1.0, *rest) for rest in product((1.0, -1.0), repeat=count - 1)])
        return every[1:]
    drawn = rng.choice([-1.0, 1.0], size=(FLIPS, count))
    return drawn * drawn[:, :1]


def covariance(grams: Grams) -> Array:
    """(parameters, parameters) of a fitted state: the posterior's, and beside it how far leaving out each fold moves
    the parameters (jackknife), for points of one trial share the model's error."""
    q = grams.parameters
    a, g = grams.gram[:, :q, :q], grams.gram[:, :q, -1]
    folds = np.unique(grams.fold)
    share = grams.observations / (grams.points.sum() * max(grams.mean_square, 1e-12))
    posterior = np.linalg.inv(share * a.sum(axis=0) + np.diag(grams.precision))
    if len(folds) < 2:
        return posterior
    alone = []
    for fold in folds:
        used = grams.fold != fold
        some = a[used].sum(axis=0), g[used].sum(axis=0)[None]
        alone.append(_solve(*some, grams, used, grams.precision, grams.x)[0])
    centred = np.array(alone)
    centred -= centred.mean(axis=0)
    return np.asarray(posterior + (len(folds) - 1) / len(folds) * centred.T @ centred)
