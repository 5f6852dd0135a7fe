"""Which effects a fit needs, to first order, by the joint normal distribution of its unknowns."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from fabdesign.nouns.array import Array, Indices
from optimize.fit.parameters import FitVector

NEEDED = 8.0  # of log likelihood or evidence: what costs less to drop is dropped; four deviations of one parameter
ALIKE = 0.98  # cosine from which on two effects are one answer


def needed(x: Array, covariance: Array, vector: FitVector, least: float) -> list[str]:
    """Return the terms that cost at least `least` of log likelihood each to switch off, one after another, the cheapest
    first, with all other unknowns moving along. x (p,), covariance (p, p)."""
    return [*eliminated(x, covariance, {label: vector.strengths(label) for label in vector.labels}, least)[0]]


def eliminated(
    x: Array, covariance: Array, parts: Mapping[str, Indices], least: float
) -> tuple[dict[str, Indices], Array]:
    """Return the parts that cost at least `least` each to drop, one after another, the cheapest first, and (p,) where
    all unknowns are then, those dropped at zero."""
    remaining = {**parts}
    while remaining:
        costs = {name: cost(x, covariance, part) for name, part in remaining.items()}
        cheapest = min(costs, key=lambda name: costs[name])
        if costs[cheapest] >= least:
            break
        x, covariance = conditioned(x, covariance, remaining.pop(cheapest))
    return remaining, x


def cost(x: Array, covariance: Array, part: Indices) -> float:
    """Return what it costs to switch unknowns off, of log likelihood."""
    return float(0.5 * x[part] @ _inverse(covariance, part) @ x[part])


def conditioned(x: Array, covariance: Array, part: Indices) -> tuple[Array, Array]:
    """Return mean and covariance where the unknowns `part` are zero."""
    gain = covariance[:, part] @ _inverse(covariance, part)
    x = x - gain @ x[part]
    covariance = covariance - gain @ covariance[part]
    x[part] = 0.0
    covariance[part], covariance[:, part] = 0.0, 0.0
    return x, covariance


def undecided(x: Array, joint: Array, names: Sequence[str], fitted: Array, kept: Sequence[str]) -> Array:
    """Return (k, k) by which the covariance of the unknowns `kept`, `fitted` (k,) alone, grows where the others of a
    joint fit x (p,), known to `joint` (p, p), by `names`, are not zero for certain: they may take what a model
    without them holds fixed, and the joint fit has other means (law of total variance, and the means' difference)."""
    common = [name for name in kept if name in names]
    columns, rows = ([[*every].index(name) for name in common] for every in (names, kept))
    dropped = np.array([i for i, name in enumerate(names) if name not in common], dtype=np.intp)
    grown = np.zeros((len(kept), len(kept)))
    apart = x[columns] - fitted[rows]
    taken = joint - conditioned(np.zeros(len(joint)), joint, dropped)[1]
    grown[np.ix_(rows, rows)] = taken[np.ix_(columns, columns)] + np.outer(apart, apart)
    return grown


def alike(sensitivity: Array, vector: FitVector, label: str, others: Iterable[str]) -> list[str]:
    """Return the terms of `others` of a fit that do what an unknown of the term `label` does (cosine over ALIKE), less
    what factors can take. sensitivity: (p, p) as `Normal` has it."""
    s = sensitivity
    factors = np.flatnonzero(vector.are_factors)
    remaining = s - s[:, factors] @ _inverse(s, factors) @ s[factors]
    return [
        other
        for other in others
        if any(does(remaining, vector.part(other), remaining[k], remaining[k, k]) for k in vector.part(label))
    ]


def does(products: Array, columns: Indices, change: Array, size: float) -> bool:
    """Return whether unknowns `columns` can do what a change does whose products with all unknowns are `change` (p,),
    and with itself `size`. products: (p, p), products of the unknowns."""
    return bool(change[columns] @ _inverse(products, columns) @ change[columns] > ALIKE**2 * size > 0)


def _inverse(matrix: Array, part: Indices) -> Array:
    """Return the pseudo-inverse of a symmetric matrix's rows and columns `part`."""
    return np.asarray(np.linalg.pinv(matrix[np.ix_(part, part)], rcond=1e-9, hermitian=True))
