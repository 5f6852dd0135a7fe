"""Whether a derivative of a shape at rest keeps the forces of the float64 reference in balance."""

from dataclasses import replace

import numpy as np
from scipy.sparse.linalg import factorized

from fabdesign.effects.acting import specimen_of, terms_of
from fabdesign.effects.registry import effect_named
from fabdesign.nouns import column
from fabdesign.nouns.column import Column, move
from fabdesign.nouns.forward import PARAMETERS, Case, Term
from sim.kernels.fields import CONTRACTION_STEP, FIRST_CONTRACTION, PRESSURE_STEP, TABLE
from tests.sim.sim_reference_effects import ReferenceWithEffects


def of_effect(effect: str, parameter: str, step: float) -> Column:
    """Return an effect's parameter, in its declared unit; from its value `off` where the case is without the effect."""
    parameters = effect_named(effect, "column").parameters
    declared = parameters[parameter]
    off = {name: one.off for name, one in parameters.items() if one.off is not None}

    def acting(case: Case) -> tuple[Term, float]:
        terms = [term for term in terms_of(case) if term.name == effect]
        term = terms[0] if terms else Term(effect, {**off, parameter: declared.centre})
        return term, term.values.get(parameter, declared.typical)

    def moved(case: Case, by: float) -> Case:
        term, value = acting(case)
        others = tuple(t for t in case.effects if (t.name, t.scope) != (effect, term.scope))
        return replace(case, effects=(*others, Term(effect, {**term.values, parameter: value + by}, term.scope)))

    def room(case: Case) -> tuple[float, float]:
        low, high = declared.bounds
        _, value = acting(case)
        return low - value, high - value

    return Column(f"{effect} {parameter}", declared.unit, step, step, moved, room)


def kinds():
    """A column of each kind that acts on a shape at rest."""
    return [
        column.pressure(0),
        *(column.factor(name) for name in PARAMETERS if name != "damping"),
        column.corner(0, 0, (1.0, 0.0)),
        column.corner(0, 1, (0.6, 0.8)),
        of_effect("rest_curvature", "down", 0.1),
        of_effect("odd_muscle", "factor", 0.01),
    ]


def kinds_of_effects():
    """A column of each further effect that adds no force of its own to a shape at rest. stroke_softening is a gain as
    odd_muscle is, supply_droop a pressure."""
    return [
        of_effect("rest_curvature", "across", 0.1),
        of_effect("rest_curvature", "twist", 0.1),
        of_effect("line_loss", "share", 1e-3),
        of_effect("orthotropy", "ratio", 1e-3),
        of_effect("frame_tilt", "about_x", 1e-2),
        of_effect("added_mass", "mass", 1e-4),
    ]


class KernelsLaw:
    """A muscle law as the kernels have it at (intervals,) pressures, linear between the grid lines of their table; from
    there it changes with the pressure as the smooth law does, by which the tangent goes too."""

    def __init__(self, law, pressures):
        self.law, self.pressures = law, pressures
        contraction = FIRST_CONTRACTION + np.arange(TABLE[1]) * CONTRACTION_STEP
        self.table = law.tension(np.arange(TABLE[0])[:, None] * PRESSURE_STEP, contraction)

    def tension(self, pressure, contraction):
        at = np.where(np.asarray(pressure) > 0, self.pressures, 0.0)  # idle ones: 0 is a grid line
        more = self.law.tension(pressure, contraction) - self.law.tension(at, contraction)
        return self._between(at, contraction) + more

    def _between(self, pressure, contraction):
        p, e = pressure / PRESSURE_STEP, (contraction - FIRST_CONTRACTION) / CONTRACTION_STEP
        j, i = (np.clip(x.astype(int), 0, count - 2) for x, count in zip((p, e), TABLE, strict=True))
        low, high = (self.table[j + k, i] + (e - i) * (self.table[j + k, i + 1] - self.table[j + k, i]) for k in (0, 1))
        return low + (p - j) * (high - low)


def sheet_of(case, n):
    """The reference of a case with any of those effects."""
    terms = {term.name: term.values for term in case.effects}
    odd, mass = terms.get("odd_muscle"), terms.get("added_mass")
    return ReferenceWithEffects(
        specimen_of(case).design,  # in which orthotropy and frame_tilt are
        n,
        factors=case.factors,
        curl=tuple(terms.get("rest_curvature", {}).get(name, 0.0) for name in ("across", "down", "twist")),
        gains={int(odd.get("channel", 0)): odd["factor"]} if odd else None,
        loss=terms.get("line_loss", {}).get("share", 0.0),
        added=tuple({"u": 0.15, "v": 0.18, "mass": 0.0, **(mass or {})}.values()),
    )


def lacking(case, columns, middle, changes, *, smooth=True):
    """(p,) relative: what the reference's forces lack of staying in balance as a column says that the shape moves,
    central differences in float64, as a displacement by the reference's Gauss-Newton stiffness, beside the column.
    smooth: the smooth muscle law; else that of the kernels, which differs between its grid lines."""
    n = len(middle)
    x, off = middle.astype(float).reshape(-1, 3), []
    sheet = sheet_of(case, n)
    acting = sheet.acting(np.asarray(case.program.pressure[-1]))

    def evaluated(variant, there):
        reference, pressure = sheet_of(variant, n), variant.program.pressure[-1]
        if not smooth:
            kinds = np.array(reference.kind)
            reference.laws = {name: KernelsLaw(law, acting[kinds == name]) for name, law in reference.laws.items()}
        return reference.evaluate(there, 0 * x, pressure)

    free = np.repeat(sheet.free, 3)
    solve = factorized(evaluated(case, x)[1][free][:, free].tocsc())
    for kind, change in zip(columns, changes, strict=True):
        along = change.astype(float).reshape(-1, 3)
        largest = np.abs(along).max()
        both = move(case, kind, 1e-6 / largest if largest > 0 else kind.step)  # 1 um at most; within the column's room
        sides = [
            evaluated(moved, x + by * along)[0].ravel()[free] for moved, by in zip(both.sides, both.by, strict=True)
        ]
        imbalance = np.linalg.norm(solve((sides[1] - sides[0]) / both.width))
        off.append(imbalance / np.linalg.norm(along) if imbalance > 0 else 0.0)  # 0 of what changes nothing
    return np.array(off)
