"""How much evidence there is for groups of unknowns of a joint fit: automatic relevance determination.

Each group has a prior variance of its own, by which the linearised data are most probable (MacKay 1994; Tipping 2001,
J. Mach. Learn. Res. 1, 211). Where the data do not need a group, or others take its part as well, that goes to zero,
and with it the group: so of many that share what one does, one is left.
"""

from collections.abc import Mapping

import numpy as np

from fabdesign.nouns.array import Array, Indices
from optimize.fit.fitted import Fit

_ROUNDS = 2000  # of updates at most; most groups settle within some hundred
_SETTLED = 1e-3  # of a logarithm, by which no variance changes any more
_LEAST, _MOST = 1e-5, 1e3  # of the declared prior's variance: below, the group is gone


def evidence(fit: Fit, groups: Mapping[str, Indices]) -> dict[str, float]:
    """Return the log evidence that each group of unknowns adds beside the others, 0 for one that is gone. All other
    unknowns keep their priors."""
    prior, precision = fit.vector.prior, fit.vector.precision
    data = fit.normal.information * np.outer(prior, prior)
    pull = (data + precision * np.outer(prior, prior)) @ (fit.minimum / prior)
    every = np.concatenate([np.zeros(0, dtype=np.intp), *groups.values()]).astype(np.intp)
    fixed = np.setdiff1d(np.arange(len(prior)), every)
    weights = dict.fromkeys(groups, 1.0)  # 1 over the variance, of the declared prior's

    def posterior(names: list[str]) -> tuple[Indices, Array]:
        """Return which unknowns there are with these groups, and their precision."""
        kept = np.concatenate([fixed, *(groups[name] for name in names)]).astype(np.intp)
        declared = [np.ones(len(fixed)), *(np.full(len(groups[name]), weights[name]) for name in names)]
        return kept, data[np.ix_(kept, kept)] + np.diag(np.concatenate(declared))

    names = [*groups]
    for _ in range(_ROUNDS):
        kept, joint = posterior(names)
        covariance = np.linalg.inv(joint)
        mean, first, change = covariance @ pull[kept], len(fixed), 0.0
        for name in names:
            part = slice(first, first := first + len(groups[name]))
            determined = len(groups[name]) - weights[name] * float(np.trace(covariance[part, part]))
            variance = float(mean[part] @ mean[part]) / max(determined, 1e-12)
            weight = 1 / np.clip(variance, 0.1 * _LEAST, _MOST)
            change, weights[name] = max(change, abs(np.log(weight / weights[name]))), weight
        names = [name for name in names if weights[name] < 1 / _LEAST]
        if change < _SETTLED:
            break

    def total(names: list[str]) -> float:
        kept, joint = posterior(names)
        narrowed = sum(len(groups[name]) * np.log(weights[name]) for name in names) - np.linalg.slogdet(joint)[1]
        return 0.5 * float(narrowed + pull[kept] @ np.linalg.solve(joint, pull[kept]))

    most = total(names)
    return dict.fromkeys(groups, 0.0) | {name: most - total([n for n in names if n != name]) for name in names}
