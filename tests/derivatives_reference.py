"""Derivatives of a shape at rest by the implicit function theorem in float64, on the reference's forces."""

import numpy as np

from fabdesign import column
from fabdesign.forward import PARAMETERS
from tests.sim_reference import ReferenceSheet
from tests.sim_reference_effects import ReferenceWithEffects


def kinds():
    """A column of each kind that acts on a shape at rest."""
    return [
        column.pressure(0),
        *(column.factor(name) for name in PARAMETERS if name != "damping"),
        column.corner(0, 0, (1.0, 0.0)),
        column.corner(0, 1, (0.6, 0.8)),
        column.of_effect("rest_curvature", "down", 0.1),
        column.of_effect("odd_muscle", "factor", 0.01),
    ]


def sheet_of(case, n):
    """The reference of a case: factors or the effects that `kinds` has, not both."""
    effects = {term.name: term.values for term in case.effects}
    if not effects:
        return ReferenceSheet(case.design, n, case.factors)
    assert not case.factors
    curl = tuple(effects.get("rest_curvature", {}).get(name, 0.0) for name in ("across", "down", "twist"))
    gains = {0: effects["odd_muscle"]["factor"]} if "odd_muscle" in effects else None
    return ReferenceWithEffects(case.design, n, curl=curl, gains=gains)


def reference_changes(case, columns, middle):
    """(p, n, n, 3) m per unit at the equilibrium near `middle`, the stiffness a matrix of differences."""
    n, sheet = len(middle), sheet_of(case, len(middle))
    x = middle.astype(float).reshape(-1, 3)
    free, e = np.repeat(sheet.free, 3), 1e-7  # m

    def force(own, at):
        return sheet_of(own, n).evaluate(at, 0 * at, own.program.pressure[-1])[0].ravel()[free]

    def stiffness_at(at):
        columns = []
        here = sheet.evaluate(at, 0 * at, case.program.pressure[-1])[0].ravel()[free]
        for entry in np.flatnonzero(free):
            moved = at.copy()
            moved.ravel()[entry] += e
            there = sheet.evaluate(moved, 0 * at, case.program.pressure[-1])[0].ravel()[free]
            columns.append((here - there) / e)
        return np.stack(columns, axis=1)

    right = [
        (force(own.moved(case, own.step / 10), x) - force(own.moved(case, -own.step / 10), x)) / (own.step / 5)
        for own in columns
    ]
    changes = np.zeros((len(columns), x.size))
    changes[:, free] = np.linalg.solve(stiffness_at(x), np.array(right).T).T
    return changes.reshape(len(columns), n, n, 3)
