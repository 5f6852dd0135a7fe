"""A term with a formula of its own, where no effect of the list explains what is missing.

The basis functions that `learned` has inside the simulator are fitted together, those that the data do not need are
dropped, and what is left is kept only if whole trials left out gain half of their excess by it.
"""

from dataclasses import replace

import numpy as np

from fabdesign.effects.learned import DISCOVERED
from fabdesign.nouns.array import Array
from optimize.fit.descent import FitStart
from optimize.fit.fitted import Fit
from optimize.fit.free_parameters import fit_vector
from optimize.fit.policy import END, ROUGH
from optimize.fit.significance import NEEDED, eliminated
from studies.model_selection.judged import Judged
from studies.model_selection.rules import Selection
from studies.model_selection.verdict import LEAST_SHARE
from studies.tracing.task import Task


def discover(task: Task, selection: Selection) -> Judged | None:
    """Fit a formula from the data sheet, as the joint fit: few coefficients beside the declared parameters. None where
    nothing is needed or too little gained."""
    inputs = selection.everything.inputs
    vector = fit_vector([DISCOVERED.name], factors=task.factors, designs=task.designs)
    full = task.fit("discovered", vector, FitStart(inputs=inputs), ROUGH)
    kept, start = _needed(full)
    if not kept:
        return None
    parameters = (p for p in vector.parameters if p.is_factor or p.name.rpartition(".")[2] in kept)
    necessary = replace(vector, parameters=tuple(parameters))
    judged = task.judged(task.fit(f"discovered, {' '.join(kept)}", necessary, FitStart(start, inputs=inputs), END))
    return judged if judged.excess <= (1 - LEAST_SHARE) * selection.before.excess else None


def _needed(fit: Fit) -> tuple[list[str], Array]:
    """Return the coefficients that cost NEEDED of log likelihood each to drop, one after another, the cheapest first;
    and (p,) where the unknowns that stay are then, to first order."""
    coefficients = {
        name: np.array([k])
        for k, (name, p) in enumerate(zip(fit.vector.names, fit.vector.parameters, strict=True))
        if not p.is_factor
    }
    remaining, x = eliminated(fit.minimum, fit.covariance, coefficients, NEEDED)
    dropped = [int(part[0]) for name, part in coefficients.items() if name not in remaining]
    return [name.rpartition(".")[2] for name in remaining], np.delete(fit.vector.inside(x), dropped)
