"""Motions at some factors beside the measured points, and how they change with each factor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.forward import PARAMETERS, Case, ForwardModel
from studies.calibrate_clouds import Array, Match, Motion, Sample, derivatives, match


@dataclass(frozen=True, eq=False)
class State:
    x: Array
    changes: list[Motion]  # (7, F, 2 n, 3) m a sample, of the vertices
    found: Match
    jacobian: Array  # (N, 7) m


def state_at(
    samples: Sequence[Sample],
    forward: ForwardModel,
    x: Array,
    *,
    along: Array | None = None,
    changes: list[Motion] | None = None,
    correction: list[Motion] | None = None,
    slopes: ForwardModel | None = None,
) -> State:
    """Motions at x; and their changes by each factor by forward differences along the rows of `along` (7, 7), in the
    same batch, or those that are given. `correction` is added to the motions; `slopes` makes the differences instead of
    `forward`."""
    others = [] if along is None else [x + row for row in along]
    if slopes is None or slopes == forward or along is None:
        base, *moved = motions_at(samples, forward, [x, *others])
        start = base
    else:
        [base] = motions_at(samples, forward, [x])
        start, *moved = motions_at(samples, slopes, [x, *others])
    if along is not None:
        differences = [np.stack([other[s] - start[s] for other in moved]) for s in range(len(samples))]
        changes = [np.tensordot(np.linalg.inv(along), difference, axes=1) for difference in differences]
    if changes is None:
        raise ValueError("neither directions nor changes")
    if correction is not None:
        base = [motion + extra for motion, extra in zip(base, correction, strict=True)]
    found = match(samples, base)
    return State(x, changes, found, derivatives(found, changes))


def correction_of(samples: Sequence[Sample], fine: ForwardModel, coarse: ForwardModel) -> list[Motion]:
    """(F, 2 n, 3) m a sample, fine less coarse; nothing where either is lost."""
    start = np.zeros(len(PARAMETERS))
    pairs = zip(*(motions_at(samples, forward, [start])[0] for forward in (fine, coarse)), strict=True)
    return [np.nan_to_num(one - other, nan=0.0) for one, other in pairs]


def motions_at(samples: Sequence[Sample], forward: ForwardModel, xs: Sequence[Array]) -> list[list[Motion]]:
    """Of every x, a motion a sample; all in one batch."""
    cases = [Case(s.trial.design, s.trial.program, _factors(x)) for x in xs for s in samples]
    motions = forward.motions(cases, [s.times for _ in xs for s in samples])
    return [list(motions[k : k + len(samples)]) for k in range(0, len(motions), len(samples))]


def _factors(x: Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip(PARAMETERS, np.exp(x), strict=True)}
