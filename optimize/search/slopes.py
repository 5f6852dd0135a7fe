"""How shapes change with a search's variables, by derivatives of the forward model where it offers them.

They are those of shapes at rest. Of a target that is a motion's frame, a second and more after the pressures rose,
they are nearly the frame's own, and cost a fraction of differences of motions; what they lack a search learns from the
steps that it tries (optimize/search/local_search.py).

Changes that would bring a result nearer: the objective to first order, where a limit were wider or a constant
another one, with the design's own variables adjusted to it.

The shape is linear in the change and in the variables; NLopt takes the best step of it (`local_search.py`), so that no
simulation but one Jacobian is needed. To first order only: good for saying what matters, not for how much.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fabdesign.nouns import column
from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Column, FacesJacobian, Jacobians
from fabdesign.nouns.forward import Case, ForwardModel
from optimize.search.design_space import PRESSURE_STEP, DesignSpace, Vector
from optimize.search.local_search import LinearShape, best_step
from optimize.search.objective import LATE, Objective, Poses, refined

Corner = tuple[int, int, int]  # muscle, corner of its path, axis


class Slopes(NamedTuple):
    """The slopes at one point of a space."""

    shape: Poses  # (poses, 2 n, 3) m, at rest
    by_variable: Array  # (n, poses, 2 n, 3) m; 0 where a derivative is not there
    by_further: Array  # (columns, poses, 2 n, 3) m per unit of further columns; NaN where that diverged


def jacobians_for(forward: ForwardModel, objective: Objective) -> Jacobians | None:
    """Return what derivatives are asked of; None where the model has none, or a target is a frame too early for
    them."""
    if any(target.time is not None and target.time < LATE for target in objective.targets):
        return None
    offered: Jacobians | None = getattr(forward, "faces_jacobian", None)
    return offered


def slopes_of(
    jacobians: Jacobians,
    objective: Objective,
    points: Sequence[tuple[DesignSpace, Vector]],
    further: Sequence[Column] = (),
) -> list[Slopes]:
    """Return the slopes of every point, whatever its layout, by its variables and by further columns; a batch for each
    pose."""
    decoded = [space.decode(x) for space, x in points]
    corners = sorted({corner for space, _ in points for corner in corners_of(space)})
    channels = max(space.channels * space.vary_pressures for space, _ in points)
    span = max(np.ptp(space.limits.pressure) for space, _ in points)
    columns = [
        *map(_within_cloth, corners),
        *(column.pressure(k, far=PRESSURE_STEP * span) for k in range(channels)),
        *further,
    ]
    place = {corner: k for k, corner in enumerate(corners)}
    poses = range(len(objective.targets))
    jacobian_of = [refined_jacobians(jacobians, objective.cases(pose, decoded), columns) for pose in poses]
    results = []
    for i, (space, x) in enumerate(points):
        rows = [place[corner] for corner in corners_of(space)]
        shape = np.array([pose[i].points for pose in jacobian_of])
        by_variable = np.zeros((len(x), *shape.shape))
        by_further = np.zeros((len(further), *shape.shape))
        at, many = space.position_count, space.channels
        for pose, changes in enumerate(one[i].changes for one in jacobian_of):
            by_further[:, pose] = changes[len(columns) - len(further) :]
            by_variable[: space.position_count, pose] = changes[rows]
            if space.vary_pressures:
                by_variable[at : at + many, pose] = changes[len(corners) : len(corners) + many]
                at += many
        by_variable *= space.units[:, None, None, None]
        by_variable[~np.isfinite(by_variable).all(axis=(1, 2, 3))] = 0.0
        results.append(Slopes(shape, by_variable, by_further))
    return results


def refined_jacobians(jacobians: Jacobians, cases: Sequence[Case], columns: Sequence[Column]) -> list[FacesJacobian]:
    """Return what `jacobians` gives, its shapes and their changes `refined`."""
    return [
        FacesJacobian(
            refined(np.asarray(one.points, float)),
            np.array([refined(change) for change in one.changes]).reshape(len(columns), -1, 3),
            one.exact,
        )
        for one in jacobians(cases, columns)
    ]


def corners_of(space: DesignSpace) -> list[Corner]:
    """Return the corners in the order of the space's variables; none where they stay."""
    if not space.vary_positions:
        return []
    return [(m, k, axis) for m, one in enumerate(space.design.muscles) for k in range(len(one.path)) for axis in (0, 1)]


def corner_column(corner: Corner) -> Column:
    """Return the column [m] of a corner."""
    muscle, index, axis = corner
    return column.corner(muscle, index, ((1.0, 0.0), (0.0, 1.0))[axis])


def _within_cloth(corner: Corner) -> Column:
    """Return the same, with its room within the cloth."""
    muscle, index, axis = corner

    def room(case: Case) -> tuple[float, float]:
        muscles, fabric = case.design.muscles, case.design.fabric
        if muscle >= len(muscles) or index >= len(muscles[muscle].path):
            return -np.inf, np.inf
        at = muscles[muscle].path[index][axis]
        return -at, (fabric.width, fabric.height)[axis] - at

    moving = corner_column(corner)
    return replace(moving, name=f"{moving.name} along {'uv'[axis]}", room=room)


RADIUS = 0.1  # reaches within which the variables adjust: farther the shape is not linear


def what_helps(
    jacobians: Jacobians,
    objective: Objective,
    point: tuple[DesignSpace, Vector],
    changes: Mapping[str, tuple[Column, float]],
    wider: Mapping[str, DesignSpace],
    others: Mapping[str, DesignSpace],
) -> tuple[float, dict[str, float]]:
    """Return the value [m] that the same step comes to without any change, and what each change by so many units of a
    column, each wider space of the same design and each other design of as many muscles and corners, by their names,
    would; to first order, the nearest first."""
    space, x = point
    layout = space.decode(x)
    columns = {direction.name: direction for direction, _ in changes.values()}
    places = [(relaxed, relaxed.encode(*layout)) for relaxed in others.values()]
    slopes, *of_others = slopes_of(jacobians, objective, [point, *places], [*columns.values()])
    of_column = dict(zip(columns, slopes.by_further, strict=True))

    def stepped(relaxed: DesignSpace, model: LinearShape) -> float:
        if not np.isfinite(model.shape).all():
            return float("nan")
        return objective.value(model.at(best_step(model, objective, relaxed, RADIUS)))

    def reached(shape: Poses, relaxed: DesignSpace) -> float:
        by_variable = slopes.by_variable * (relaxed.units / space.units)[:, None, None, None]
        return stepped(relaxed, LinearShape(relaxed.encode(*layout), shape, by_variable))

    values = {what: reached(slopes.shape + by * of_column[moved.name], space) for what, (moved, by) in changes.items()}
    values |= {what: reached(slopes.shape, relaxed) for what, relaxed in wider.items()}
    for what, (relaxed, there), one in zip(others, places, of_others, strict=True):
        values[what] = stepped(relaxed, LinearShape(there, one.shape, one.by_variable))
    finite = [(what, value) for what, value in values.items() if np.isfinite(value)]
    return reached(slopes.shape, space), dict(sorted(finite, key=lambda item: item[1]))
