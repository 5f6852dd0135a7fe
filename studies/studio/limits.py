"""The limits of a layout in words, where they are broken: the margins of the search, and what `check` finds."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from fabdesign.design import Design
from fabdesign.muscle import Muscle
from fabdesign.pressure import LARGEST
from fabdesign.pressure import limits as pressure_limits
from fabdesign.units import in_kpa, in_mm
from optimize.geometry import bend_radius, clearance
from optimize.margins import Limits, constraint_margins
from studies.studio.layout import Layout

_ROUNDING = 1e-6  # m


@dataclass(frozen=True)
class Broken:
    """A limit that is broken: its name in `optimize`'s results, a sentence, and whom it is about."""

    limit: str
    message: str
    muscles: tuple[int, ...] = ()
    channel: int | None = None


def broken_limits(layout: Layout, limits: Limits) -> list[Broken]:
    """Of every muscle, every two on one face, and every channel. Muscles and channels count from 0, as in files."""
    design = layout.design
    broken = [line for i, muscle in enumerate(design.muscles) for line in _of_one(design, i, muscle, limits)]
    broken += _of_pairs(design, limits)
    return broken + _of_pressures(layout, limits)


def _of_one(design: Design, index: int, muscle: Muscle, limits: Limits) -> list[Broken]:
    alone = replace(design, muscles=(muscle,))
    margins = constraint_margins(alone, np.full(1, limits.pressure[0]), limits)
    kind, who = design.muscle_types[muscle.type], (index,)
    length = f"{in_mm(muscle.length):.1f} mm long"
    broken = []
    if (free := margins["inside_cloth"]) < limits.edge - _ROUNDING:
        message = f"lies {in_mm(free):.1f} mm from the edge; expected {in_mm(limits.edge):g} mm"
        broken.append(Broken("edge", f"muscle {index} {message}", who))
    if margins["shortest"] < -_ROUNDING:
        message = (
            f"is {length}; expected two pitches, {2e3 * muscle.fixed_point_pitch:g} mm, or it hardly bends the cloth"
        )
        broken.append(Broken("shortest", f"muscle {index} {message}", who))
    if margins.get("stock_length", 0.0) < -_ROUNDING:
        most = (kind.stock_length or 0.0) - 2 * (kind.tail_length or 0.0)
        message = f"is {length}; expected at most {in_mm(most):.0f} mm, the stock of {kind.name} less its tails"
        broken.append(Broken("stock_length", f"muscle {index} {message}", who))
    if margins.get("min_bend_radius", 0.0) < -_ROUNDING and kind.min_bend_radius is not None:
        radius = in_mm(bend_radius(np.array(muscle.path)))
        message = f"has a corner of {radius:.1f} mm radius; expected {in_mm(kind.min_bend_radius):g} mm of {kind.name}"
        broken.append(Broken("min_bend_radius", f"muscle {index} {message}", who))
    return broken


def _of_pairs(design: Design, limits: Limits) -> list[Broken]:
    broken = []
    paths = [np.array(muscle.path) for muscle in design.muscles]
    low, high = (np.array([end(path) for path in paths]).reshape(-1, 2) for end in (_lowest, _highest))
    for i, j in combinations(range(len(paths)), 2):
        side = design.muscles[i].side
        far = np.any(low[i] - high[j] >= limits.spacing) or np.any(low[j] - high[i] >= limits.spacing)
        if side != design.muscles[j].side or far:
            continue
        gap = clearance(paths[i], paths[j])
        if gap < 0:
            broken.append(Broken("crossing", f"muscles {i} and {j} cross on the {side}; expected them apart", (i, j)))
        elif gap < limits.spacing - _ROUNDING:
            message = f"lie {in_mm(gap):.1f} mm apart on the {side}; expected {in_mm(limits.spacing):g} mm"
            broken.append(Broken("spacing", f"muscles {i} and {j} {message}", (i, j)))
    return broken


def _lowest(path: np.ndarray) -> np.ndarray:
    return np.asarray(path.min(axis=0))


def _highest(path: np.ndarray) -> np.ndarray:
    return np.asarray(path.max(axis=0))


def _of_pressures(layout: Layout, limits: Limits) -> list[Broken]:
    broken = []
    for channel, most in enumerate(pressure_limits(layout.design)):
        pressure, why = layout.pressures[channel], "the muscles' maximum"
        if most >= LARGEST or most > limits.pressure[1]:
            most, why = limits.pressure[1], "the highest that is searched"
        if pressure > most + 1e-6 or pressure < limits.pressure[0] - 1e-6:
            message = (
                f"{in_kpa(pressure):g} kPa; expected {in_kpa(limits.pressure[0]):g} to {in_kpa(most):g} kPa, {why}"
            )
            broken.append(Broken("pressure", f"channel {channel} has {message}", channel=channel))
    return broken
