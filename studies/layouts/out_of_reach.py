"""A target that is out of reach: where the nearest shape misses it, and what would bring it nearer."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.spatial import KDTree

from fabdesign.geometry.shape import Shape
from fabdesign.nouns.column import factor
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.pressure import LARGEST
from fabdesign.study_files.study_file import Study
from fabdesign.units import in_kpa, in_mm
from optimize.search.design_space import DesignSpace
from optimize.search.objective import Objective
from optimize.search.slopes import Change, Nearer, jacobians_for, what_helps
from optimize.search.starts import Start
from studies.layout_search.target import LoadedTarget

AREA = 0.15  # of the cloth's sides, over which a distance is averaged: single points are noise
BY = 0.2  # of a declared value
WIDER = 0.1  # of the pressure range
WORTH = 0.02  # of the objective, under which a change is not worth a word
SAID = 3
CHANGED_FACTORS = {
    "membrane": "membrane stiffness",
    "shear": "shear stiffness",
    "bending": "bending stiffness",
    "areal_density": "areal density of the cloth",
    "muscle_gain": "pull of the muscles at the same pressure",
    "axis_offset": "distance of the muscles' axes from the cloth",
}


@dataclass(frozen=True)
class Missed:
    """Where a shape lies farthest from its target. place: (u, v) m; off: m, mean distance around it."""

    place: tuple[float, float]
    off: float


@dataclass(frozen=True)
class Helps:
    """before: m of the objective, to first order, with the variables adjusted and nothing changed; nearer: what would
    gain, most first."""

    before: float
    nearer: tuple[Nearer, ...]

    @property
    def sentences(self) -> list[str]:
        if not self.nearer:
            return [f"By derivatives no limit or constant that is changed by {BY:.0%} gains {WORTH:.0%}."]
        gains = [f"{change.what}: {in_mm(self.before - change.value):.1f} mm" for change in self.nearer[:SAID]]
        return [f"What would bring it nearer, by derivatives: {'; '.join(gains)}."]

    def as_json(self) -> list[dict[str, Any]]:
        """Return a row a change."""
        return [{"what": change.what, "gain_mm": in_mm(self.before - change.value)} for change in self.nearer]


def missed_at(shape: NDArray[np.float64], target: LoadedTarget, size: tuple[float, float]) -> Missed:
    """Return where one pose misses: shape (2 n, 3) m beside its target, both ways, of wishes the one that lies farthest
    off; size: (width, height) m of the cloth."""
    if target.landmarks is not None:
        off = target.landmarks.distances(shape)
        worst = int(np.argmax(off))
        u, v = (target.landmarks.shares[worst] * size).tolist()
        return Missed((u, v), float(off[worst]))
    middle = Shape.of(shape).middle  # (rows, columns, 3)
    rows, columns = middle.shape[:2]
    points = middle.reshape(-1, 3)
    to_cloth, nearest = KDTree(points).query(target.points)
    both = np.zeros(len(points)) if target.markers else KDTree(target.points).query(points)[0]
    np.maximum.at(both, nearest, to_cloth)
    window = tuple(max(1, round(AREA * n)) for n in (rows, columns))
    smooth = uniform_filter(both.reshape(rows, columns), window, mode="nearest")
    row, column = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
    place = column / (columns - 1) * size[0], row / (rows - 1) * size[1]
    return Missed((float(place[0]), float(place[1])), float(smooth[row, column]))


def helps_of(study: Study, point: Start, objective: Objective, forward: ForwardModel) -> Helps | None:
    """Return what helps a result; None where the forward model has no derivatives, or the targets are frames too early
    for them."""
    jacobians = jacobians_for(forward, objective)
    if jacobians is None:
        return None
    changes = [
        Change(f"{BY:.0%} {'more' if sign > 0 else 'less'} {what}", factor(name), sign * BY)
        for name, what in CHANGED_FACTORS.items()
        for sign in (1, -1)
    ]
    before, nearer = what_helps(jacobians, objective, point, changes, _wider(study, point[0]), _of_types(point[0]))
    return Helps(before, tuple(change for change in nearer if before - change.value > WORTH * before))


def _wider(study: Study, space: DesignSpace) -> dict[str, DesignSpace]:
    """Return the space with one limit wider, by what that is."""
    limits = space.limits
    low, high = limits.pressure
    spaces: dict[str, DesignSpace] = {}
    most = min((kind.max_pressure or LARGEST for kind in study.design.muscle_types.values()), default=LARGEST)
    highest = high + WIDER * (high - low)
    if space.vary_pressures and highest <= most:
        spaces[f"pressures up to {in_kpa(highest):.0f} kPa"] = replace(
            space, limits=replace(limits, pressure=(low, highest))
        )
    if space.vary_positions:
        spaces["half the spacing"] = replace(space, limits=replace(limits, spacing=limits.spacing / 2))
    return spaces


def _of_types(space: DesignSpace) -> dict[str, DesignSpace]:
    """Return the space with all muscles of one type, of those that the design has besides."""
    muscles = space.design.muscles
    spaces = {}
    for name in space.design.muscle_types:
        if any(muscle.type != name for muscle in muscles):
            changed = tuple(replace(muscle, type=name) for muscle in muscles)
            spaces[f"muscles of type {name}"] = replace(space, design=replace(space.design, muscles=changed))
    return spaces


def missed_said(missed: Sequence[Missed]) -> list[str]:
    """Return where the shape misses, in words."""
    said = []
    for pose, miss in enumerate(missed, start=1):
        of = f" in pose {pose}" if len(missed) > 1 else ""
        u, v = (in_mm(x) for x in miss.place)
        said.append(f"It misses the target most{of} around u {u:.0f}, v {v:.0f} mm: {in_mm(miss.off):.1f} mm.")
    return said
