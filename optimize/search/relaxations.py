"""Changes that would bring a result nearer: the objective to first order, where a limit were wider or a constant
another one, with the design's own variables adjusted to it.

The shape is linear in the change and in the variables; NLopt takes the best step of it (`step.py`), so that no
simulation but one Jacobian is needed. To first order only: good for saying what matters, not for how much.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.nouns.column import Column
from fabdesign.nouns.jacobian import Jacobians
from optimize.search.design_space import DesignSpace, Vector
from optimize.search.objective import Objective, Shape
from optimize.search.slopes import slopes_of
from optimize.search.step import LinearShape, best_step

RADIUS = 0.1  # reaches within which the variables adjust: farther the shape is not linear


@dataclass(frozen=True)
class Change:
    """`by` units of a column."""

    what: str  # for people, as in "20 % less bending stiffness"
    column: Column
    by: float


@dataclass(frozen=True)
class Nearer:
    """value: m of the objective to first order."""

    what: str
    value: float


def what_helps(
    jacobians: Jacobians,
    objective: Objective,
    point: tuple[DesignSpace, Vector],
    changes: Sequence[Change],
    wider: Mapping[str, DesignSpace],
    others: Mapping[str, DesignSpace] | None = None,
) -> tuple[float, list[Nearer]]:
    """Return the value [m] that the same step comes to without any change, and what each change, each wider space of
    the same design and each other design of as many muscles and corners, by their names, would; the nearest first."""
    space, x = point
    layout = space.decode(x)
    columns = {relaxed.column.name: relaxed.column for relaxed in changes}
    others = others or {}
    places = [(relaxed, relaxed.encode(*layout)) for relaxed in others.values()]
    slopes, *of_others = slopes_of(jacobians, objective, [point, *places], [*columns.values()])
    of_column = dict(zip(columns, slopes.by_further, strict=True))

    def stepped(relaxed: DesignSpace, model: LinearShape) -> float:
        if not np.isfinite(model.shape).all():
            return float("nan")
        return objective.value(model.at(best_step(model, objective, relaxed, RADIUS)))

    def reached(shape: Shape, relaxed: DesignSpace) -> float:
        by_variable = slopes.by_variable * (relaxed.units / space.units)[:, None, None, None]
        return stepped(relaxed, LinearShape(relaxed.encode(*layout), shape, by_variable))

    shifted = [slopes.shape + relaxed.by * of_column[relaxed.column.name] for relaxed in changes]
    nearer = [Nearer(relaxed.what, reached(shape, space)) for relaxed, shape in zip(changes, shifted, strict=True)]
    nearer += [Nearer(what, reached(slopes.shape, relaxed)) for what, relaxed in wider.items()]
    nearer += [
        Nearer(what, stepped(relaxed, LinearShape(there, of_other.shape, of_other.by_variable)))
        for what, (relaxed, there), of_other in zip(others, places, of_others, strict=True)
    ]
    return reached(slopes.shape, space), sorted(
        (relaxed for relaxed in nearer if np.isfinite(relaxed.value)), key=lambda relaxed: relaxed.value
    )
