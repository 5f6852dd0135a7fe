"""Whether a derivative of a shape at rest keeps the forces of the float64 reference in balance."""

import numpy as np
from scipy.sparse.linalg import factorized

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


def lacking(case, columns, middle, changes):
    """(p,) relative: what the reference's forces lack of staying in balance as a column says that the shape moves,
    central differences in float64, as a displacement by the reference's Gauss-Newton stiffness, beside the column."""
    n = len(middle)
    x, off = middle.astype(float).reshape(-1, 3), []
    sheet = sheet_of(case, n)
    free = np.repeat(sheet.free, 3)
    solve = factorized(sheet.evaluate(x, 0 * x, case.program.pressure[-1])[1][free][:, free].tocsc())
    for own, change in zip(columns, changes, strict=True):
        along = change.astype(float).reshape(-1, 3)
        by = 1e-6 / np.abs(along).max()  # 1 um at most
        sides = []
        for sign in (-1, 1):
            moved = own.moved(case, sign * by)
            there = x + sign * by * along
            sides.append(sheet_of(moved, n).evaluate(there, 0 * x, moved.program.pressure[-1])[0].ravel()[free])
        left = solve((sides[1] - sides[0]) / (2 * by))
        off.append(np.linalg.norm(left) / np.linalg.norm(along))
    return np.array(off)
