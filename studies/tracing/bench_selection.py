"""Which columns beside a bench's quasi-static law its residuals need, one effect after another."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.effects import EFFECTS
from optimize.fit.clouds import Indices
from studies.tracing.bench_candidates import Shape
from studies.tracing.bench_ranking import (
    Array,
    BenchCandidate,
    Grams,
    Ranking,
    Variant,
    covariance,
    gain_interval,
    rank,
)

_FREE = 2e4  # deviation of coefficients whose prior says nothing
_MOST, _WORTH = 3, 0.15


@dataclass(frozen=True, eq=False)
class Columns:
    """residual (n,): law less measured; trial (n,): of which record. tables: of each shape {parameter: (n,)}."""

    shapes: Sequence[Shape]
    tables: Sequence[Mapping[str, Array]]
    residual: Array
    trial: Indices

    def table(self, k: int) -> Array:
        """(n, parameters)"""
        return np.column_stack([*self.tables[k].values()])


@dataclass(frozen=True, eq=False)
class Selected:
    """added: places of shapes; base (n, k): their columns. first, last: the rankings without and beside all of them;
    grams: of the last. gains: share of the first excess, by effect. alike: what the last could not be told from.
    refused: what could explain some at first, but only with a sign that it cannot have."""

    added: Sequence[int]
    base: Array
    first: Ranking
    last: Ranking
    grams: Grams
    gains: Mapping[str, float]
    alike: tuple[str, ...]
    refused: tuple[str, ...]


def select(columns: Columns, floor: float, limit: float) -> Selected:
    """Until no more than `limit` of excess is left, or nothing that is worth it."""
    added: list[int] = []
    gains: dict[str, float] = {}
    alike: tuple[str, ...] = ()
    first: Ranking | None = None
    refused: tuple[str, ...] | None = None
    while True:
        base = np.column_stack([np.zeros((len(columns.trial), 0)), *(columns.table(k) for k in added)])
        taken = {columns.shapes[k].effect for k in added}
        left = [k for k, shape in enumerate(columns.shapes) if shape.effect not in taken]
        grams, variants = _grams(
            base, [columns.table(k) for k in left], [columns.shapes[k] for k in left], columns.residual, columns.trial
        )
        ranking = rank(grams, variants, floor)
        first = first or ranking
        worth, wrong = _worth(columns, base, ranking, variants, left)
        refused = wrong if refused is None else refused
        if ranking.excess <= limit or not worth or len(added) >= _MOST:
            return Selected(added, base, first, ranking, grams, gains, alike, refused)
        best, place = worth[0]
        rng = np.random.default_rng(0)
        alike = tuple(c.effect for c, _ in worth[1:] if gain_interval(grams, c.best, best.best, floor, rng)[0] <= 0)
        gains[best.effect] = best.gain / max(first.excess, 1e-30)
        added.append(place)


def _worth(
    columns: Columns, base: Array, ranking: Ranking, variants: Sequence[Variant], left: Sequence[int]
) -> tuple[list[tuple[BenchCandidate, int]], tuple[str, ...]]:
    """Candidates that gain enough for certain with the places of their shapes, and the names of those that do so only
    with a sign that they cannot have."""
    worth: list[tuple[BenchCandidate, int]] = []
    refused: list[str] = []
    for candidate in ranking.candidates:
        if not ranking.certain(candidate) or candidate.gain <= _WORTH * ranking.excess:
            continue
        assert candidate.best.variant is not None
        place = left[variants.index(candidate.best.variant)]
        beside = np.column_stack([base, columns.table(place)])
        fitted = coefficients_of(beside, columns.residual, columns.trial)
        if _right_sign(columns.shapes[place], [*columns.tables[place]], *fitted):
            worth.append((candidate, place))
        else:
            refused.append(candidate.effect)
    return worth, tuple(refused)


def coefficients_of(base: Array, residual: Array, trial: Indices) -> tuple[Array, Array]:
    """Of columns (n, k), and their standard deviations by leaving out records."""
    if not base.shape[1]:
        return np.zeros(0), np.zeros(0)
    size = np.maximum(np.sqrt(np.mean(base**2, axis=0)), 1e-30)
    fitted = np.linalg.lstsq(base, residual, rcond=None)[0]
    grams, _ = _grams(base, [], [], residual, trial)
    return np.asarray(-fitted), np.asarray(np.sqrt(np.diag(covariance(grams))) / size)


def _right_sign(shape: Shape, names: Sequence[str], coefficients: Array, deviation: Array) -> bool:
    """Of the shape's own parameters, whose columns are the last: none is less than nothing for certain, unless it may
    be."""
    declared = EFFECTS[shape.effect].parameters if shape.effect in EFFECTS else {}
    free = [name in declared and declared[name].bounds[0] < 0 for name in names]
    most = (coefficients + 1.645 * deviation)[-len(names) :]
    return all(m >= 0 or f for m, f in zip(most, free, strict=True))


def _grams(
    base: Array, tables: Sequence[Array], shapes: Sequence[Shape], residual: Array, trial: Indices
) -> tuple[Grams, list[Variant]]:
    scaled = [t / np.maximum(np.sqrt(np.mean(t**2, axis=0)), 1e-30) for t in tables]
    size = np.sqrt(np.mean(base**2, axis=0)) if base.shape[1] else np.ones(0)
    table = np.column_stack([base / np.maximum(size, 1e-30), *scaled, residual])
    count = int(trial.max()) + 1
    gram = np.stack([table[trial == k].T @ table[trial == k] for k in range(count)])
    points = np.bincount(trial).astype(float)
    index = np.arange(count)
    q = base.shape[1]
    grams = Grams(gram, index, index, points, np.full(q, 1e-12), np.zeros(q), 10.0 * count)
    variants: list[Variant] = []
    first = 0
    for shape, part in zip(shapes, scaled, strict=True):
        variants.append(Variant(shape.effect, tuple(range(first, first + part.shape[1])), _FREE, shape.values))
        first += part.shape[1]
    return grams, variants
