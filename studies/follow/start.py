"""Where the solver begins: shapes at rest that come near what is wanted, one instant after another (quasi-static)."""

from collections.abc import Sequence
from dataclasses import replace
from math import isqrt

import numpy as np

from fabdesign.geometry.shape import Shape
from fabdesign.nouns.array import Array
from fabdesign.nouns.column import pressure
from fabdesign.nouns.forward import Case
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram
from studies.follow.programs import UNIT, Regulator
from studies.follow.wanted import Wanted
from studies.follow.wanted import moved as moved_distances

APART = 0.3  # s between two instants, at least
STEPS = 3  # of Gauss-Newton
BEGIN = 0.2  # of the highest pressures, where the first instant's search begins
FARTHEST = 0.8  # of UNIT, by which a pressure moves at once
STIFF = 1.0  # of 1 / UNIT^2: the prior's, about where a pressure is


def quasi_static(predictor: Predictor, case: Case, wanted: Wanted, regulator: Regulator, cycles: int) -> Array:
    """Return set points (cycles, channels) Pa between those whose shapes at rest are nearest to what is wanted at
    instants APART s apart. What a shape at rest cannot say keeps the pressures that it had."""
    moments = _apart(wanted.times)
    pressures = np.tile(regulator.lowest + BEGIN * (regulator.highest - regulator.lowest), (len(moments), 1))
    costs = np.full(len(moments), np.inf)
    nearest = pressures.copy()
    columns = [pressure(channel) for channel in range(regulator.channels)]
    jacobians = predictor.faces_jacobian
    assert jacobians is not None
    for _ in range(STEPS):
        held = [replace(case, program=PressureProgram(np.zeros(1), row[None], 1.0)) for row in pressures]
        shapes = jacobians(held, columns)
        for k, (moment, shape) in enumerate(zip(moments, shapes, strict=True)):
            side = isqrt(len(shape.points) // 2)
            distances = wanted.distances(int(moment), shape.points, side)
            if distances is None or distances.cost >= costs[k]:
                pressures[k] = (pressures[k] + nearest[k]) / 2
                continue
            costs[k], nearest[k] = distances.cost, pressures[k]
            slopes = np.nan_to_num(UNIT * moved_distances(distances, Shape.of(shape.changes).middle))
            hessian = slopes.T @ (distances.robust[:, None] * slopes) + STIFF * np.eye(len(columns))
            change = np.linalg.solve(hessian, slopes.T @ (distances.robust * distances.off))
            moved = pressures[k] - UNIT * np.clip(change, -FARTHEST, FARTHEST)
            pressures[k] = np.clip(moved, regulator.lowest, regulator.highest)
    times = np.concatenate([[0.0], wanted.times[moments]])
    rows = np.concatenate([np.zeros((1, regulator.channels)), nearest])
    at = regulator.cycle * (np.arange(cycles) + 0.5)
    return regulator.kept(np.stack([np.interp(at, times, row) for row in rows.T], axis=1))


def _apart(times: Array) -> Sequence[int]:
    """Numbers of instants at least APART s apart, the last one among them."""
    chosen: list[int] = []
    for k in range(len(times) - 1, -1, -1):
        if not chosen or times[chosen[-1]] - times[k] >= APART - 1e-9:
            chosen.append(k)
    return chosen[::-1]
