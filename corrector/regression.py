"""The coefficients of the basis functions: ridge regression on many trials at once, in closed form."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from corrector.examples import Examples

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Regression:
    """How the field corrector is trained: what is tried, and chosen from on trials and layouts left out."""

    penalties: tuple[float, ...] = (
        1e-3,
        3e-3,
        1e-2,
        3e-2,
        1e-1,
    )  # of a coefficient's square, where its function makes 1 mm RMS
    shares: tuple[float, ...] = (1.0, 0.75, 0.5, 0.25)  # of the correction, for layouts not learned from
    folds: int = 6
    seed: int = 0


def coefficients_of(
    examples: Sequence[Examples], penalty: float, least: Array, columns: NDArray[np.bool_] | None = None
) -> Array:
    """Return (K,) coefficients, zero outside `columns`, that leave least of the examples' errors, relative to those
    before.

    The penalty is on what a function does, not on its unit: a coefficient counts by the RMS of the heights that it
    makes, as a share of the error before, and by `least` (K,) at least: what moves the cloth in its plane hardly shows
    in heights, and must not grow for that.
    """
    matrix, right = (np.sum([e.equations[i] for e in examples], axis=0) for i in (0, 1))
    frames = sum(len(e) for e in examples)
    result = np.zeros(len(right))
    kept = np.flatnonzero(np.ones(len(right), dtype=bool) if columns is None else columns)
    size = np.maximum(np.sqrt(np.diag(matrix) / frames), least)[kept]
    scaled = matrix[np.ix_(kept, kept)] / np.outer(size, size) + penalty * frames * np.eye(len(kept))
    result[kept] = np.linalg.solve(scaled, right[kept] / size) / size
    return result


def relative_error(examples: Sequence[Examples], coefficients: Array | None = None) -> float:
    """Return what is left of the errors before, mean over frames."""
    before = np.concatenate([e.errors() for e in examples])
    after = before if coefficients is None else np.concatenate([e.errors(coefficients) for e in examples])
    return float(np.mean(after / np.maximum(before, 0.5)))


def best_penalty(examples: Sequence[Examples], folds: Sequence[Sequence[int]], plan: Regression, least: Array) -> float:
    """Return the penalty that leaves least of trials not learned from; `folds`: indices of those kept back in turn. The
    largest where there is nothing to try it on."""
    if not folds:
        return plan.penalties[-1]
    remaining = np.zeros(len(plan.penalties))
    for kept_back in folds:
        rest = [e for i, e in enumerate(examples) if i not in set(kept_back)]
        held_out = [examples[i] for i in kept_back]
        for k, penalty in enumerate(plan.penalties):
            remaining[k] += len(held_out) * relative_error(held_out, coefficients_of(rest, penalty, least))
    return plan.penalties[int(remaining.argmin())]
