"""Ranking by cross-validation over whole trials: linear algebra on each trial's Gram matrix.

At a state the residual is r + J d + C b: declared parameters d, a candidate's columns b, each with its prior. What one
trial says of all of them is its Gram matrix of [J C r]; folds, bootstraps and null distributions need no more.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from studies.tracing.dictionary import Dictionary, Variant
from studies.tracing.fit import Bench, State
from studies.tracing.vector import Array

FLIPS = 200  # sign vectors of the null at most
BOOTSTRAP = 2000  # draws of trials
ALIKE = 0.98  # cosine from which on two candidates are one answer
LEAST_TRIALS = 7  # under which halves of trials are flipped, for there are too few of them
_ROUNDS = 3  # of the noise's size against the fit


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

    def flipped(self, signs: Array) -> "Grams":
        """With the residual of each unit turned by its sign."""
        gram = self.gram.copy()
        gram[:, -1, :-1] *= signs[:, None]
        gram[:, :-1, -1] *= signs[:, None]
        return Grams(gram, self.trial, self.fold, self.points, self.precision, self.x, self.observations)


def grams_of(bench: Bench, state: State, columns: Array, folds: Sequence[int]) -> Grams:
    """folds: of each sample."""
    count = len(bench.samples)
    halves = count < LEAST_TRIALS
    table = np.column_stack([state.slopes, columns, state.residual])
    unit = state.found.sample * 2
    if halves:
        middle = np.array([len(s.times) // 2 for s in bench.samples])
        unit = unit + (state.found.frame >= middle[state.found.sample])
    names = np.unique(unit)
    gram = np.stack([table[unit == u].T @ table[unit == u] for u in names])
    points = np.array([state.kept[unit == u].sum() for u in names], dtype=float)
    trial = names // 2
    return Grams(gram, trial, np.asarray(folds)[trial], points, state.vector.precision, state.x, bench.observations)


@dataclass(frozen=True, eq=False)
class Scored:
    """A candidate cross-validated. squares: (units,) m^2, sums over each unit's points when it is held out."""

    variant: Variant | None  # None: nothing is added
    squares: Array
    coefficients: Array  # of its columns, fitted to all trials


def cross_validate(grams: Grams, variant: Variant | None) -> Scored:
    """Every fold predicted from the others, the declared parameters fitted along."""
    columns = [*range(grams.parameters), *((grams.parameters + c for c in variant.columns) if variant else ())]
    own = np.ix_(columns, columns)
    precision = grams.precision
    centre = grams.x
    if variant is not None:
        more = len(variant.columns)
        precision = np.concatenate([precision, np.full(more, 1 / variant.deviation**2)])
        centre = np.concatenate([centre, np.zeros(more)])
    a, g = grams.gram[(slice(None), *own)], grams.gram[:, columns, -1]
    squares = np.empty(len(grams.points))
    for fold in np.unique(grams.fold):
        out = grams.fold == fold
        step = _solve(a[~out].sum(axis=0), g[~out].sum(axis=0), grams, ~out, precision, centre)
        squares[out] = np.einsum("uij,i,j->u", a[out], step, step) + 2 * g[out] @ step + grams.gram[out, -1, -1]
    everything = np.ones(len(grams.points), dtype=bool)
    step = _solve(a.sum(axis=0), g.sum(axis=0), grams, everything, precision, centre)
    return Scored(variant, np.maximum(squares, 0.0), step[grams.parameters :])


def _solve(a: Array, g: Array, grams: Grams, used: NDArray[np.bool_], precision: Array, centre: Array) -> Array:
    points = grams.points[used].sum()
    before = grams.gram[used, -1, -1].sum() / points
    size, step = before, np.zeros(len(g))
    for _ in range(_ROUNDS):
        share = grams.observations * (points / grams.points.sum()) / (points * max(size, 1e-12))
        step = -np.linalg.solve(share * a + np.diag(precision), share * g + precision * centre)
        size = max(before + (step @ a @ step + 2 * g @ step) / points, 0.05 * before)
    return step


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at its best variant. held_out: m RMS when trials are left out in turn; gain: m of excess that it takes
    from that of `none`; interval90 of the gain by resampling trials."""

    effect: str
    best: Scored
    held_out: float
    gain: float
    interval90: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Ranking:
    none: Scored
    none_held_out: float  # m RMS
    candidates: tuple[Candidate, ...]  # best first
    chance: float  # m of gain that the best of all candidates reaches where there is none, in 19 of 20 cases
    decoy: float  # m of gain of the best decoy
    excess: float  # m, held out, without any

    def certain(self, candidate: Candidate) -> bool:
        """Whether it gains what neither chance nor a decoy does."""
        return candidate.gain > max(self.chance, self.decoy) and candidate.interval90[0] > 0


def rank(grams: Grams, found: Dictionary, floor: float, *, seed: int = 0) -> Ranking:
    """floor: m, RMS of the sensor's noise in the residuals."""
    none = cross_validate(grams, None)
    scored = {id(v): cross_validate(grams, v) for v in found.variants}
    rng = np.random.default_rng(seed)
    candidates = []
    for effect in found.effects:
        own = [scored[id(v)] for v in found.variants if v.effect == effect and not v.decoy]
        best = min(own, key=lambda s: s.squares.sum())
        candidates.append(
            Candidate(
                effect,
                best,
                held_out(grams, best),
                excess_of(grams, none, floor) - excess_of(grams, best, floor),
                gain_interval(grams, none, best, floor, rng),
            )
        )
    before = excess_of(grams, none, floor)
    decoys = [before - excess_of(grams, scored[id(v)], floor) for v in found.variants if v.decoy]
    return Ranking(
        none,
        held_out(grams, none),
        tuple(sorted(candidates, key=lambda c: c.held_out)),
        _chance(grams, found, floor, rng),
        max(decoys, default=0.0),
        before,
    )


def held_out(grams: Grams, scored: Scored) -> float:
    """m RMS."""
    return float(np.sqrt(scored.squares.sum() / grams.points.sum()))


def excess_of(grams: Grams, scored: Scored, floor: float) -> float:
    return float(_excess(scored.squares.sum() / grams.points.sum(), floor))


def _excess(mean_square: Array | float, floor: float) -> Array:
    return np.sqrt(np.maximum(np.asarray(mean_square) - floor**2, 0.0))


def gain_interval(
    grams: Grams, worse: Scored, better: Scored, floor: float, rng: np.random.Generator
) -> tuple[float, float]:
    """90 %, m of excess, resampling folds."""
    folds = np.unique(grams.fold)
    sums = np.array([[x[grams.fold == f].sum() for x in (worse.squares, better.squares, grams.points)] for f in folds])
    drawn = sums[rng.integers(0, len(folds), size=(BOOTSTRAP, len(folds)))].sum(axis=1)
    gains = _excess(drawn[:, 0] / drawn[:, 2], floor) - _excess(drawn[:, 1] / drawn[:, 2], floor)
    low, high = np.quantile(gains, [0.05, 0.95])
    return float(low), float(high)


def _chance(grams: Grams, found: Dictionary, floor: float, rng: np.random.Generator) -> float:
    """m: the 95 % quantile of the largest gain of all variants where the residual of each unit has a sign by chance, so
    that nothing in it agrees from trial to trial (wild bootstrap, Liu 1988)."""
    gains = []
    for signs in sign_vectors(len(grams.points), rng):
        turned = grams.flipped(signs)
        none = cross_validate(turned, None)
        before = excess_of(turned, none, floor)
        best = [excess_of(turned, cross_validate(turned, v), floor) for v in found.variants if not v.decoy]
        gains.append(before - min(best, default=before))
    return float(np.quantile(gains, 0.95)) if gains else 0.0


def sign_vectors(count: int, rng: np.random.Generator) -> Array:
    """(n, count) of +1 and -1, the first +1, without the one that changes nothing: all, or FLIPS by chance."""
    if 2 ** (count - 1) <= FLIPS:
        every = np.array([(1.0, *rest) for rest in product((1.0, -1.0), repeat=count - 1)])
        return every[1:]
    drawn = rng.choice([-1.0, 1.0], size=(FLIPS, count))
    return drawn * drawn[:, :1]


def alike(grams: Grams, one: Scored, others: Sequence[Scored]) -> list[float]:
    """Cosine of what each of `others` takes with what `one` takes, less what the declared parameters can take."""
    q = grams.parameters
    total = grams.gram.sum(axis=0)
    share = grams.observations / (grams.points.sum() * max(grams.mean_square, 1e-12))
    j = share * total[:q, :q] + np.diag(grams.precision)

    def inner(a: Scored, b: Scored) -> float:
        ca, cb = ([q + c for c in s.variant.columns] if s.variant else [] for s in (a, b))
        cross = total[np.ix_(ca, cb)] - share * total[np.ix_(ca, range(q))] @ np.linalg.solve(
            j, total[np.ix_(range(q), cb)]
        )
        return float(a.coefficients @ cross @ b.coefficients)

    own = inner(one, one)
    return [inner(one, other) / max(np.sqrt(own * max(inner(other, other), 0.0)), 1e-30) for other in others]


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
    alone = np.array(
        [
            _solve(
                a[grams.fold != f].sum(axis=0),
                g[grams.fold != f].sum(axis=0),
                grams,
                grams.fold != f,
                grams.precision,
                grams.x,
            )
            for f in folds
        ]
    )
    centred = alone - alone.mean(axis=0)
    return np.asarray(posterior + (len(folds) - 1) / len(folds) * centred.T @ centred)
