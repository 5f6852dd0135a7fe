"""The change of the forces by a column before anything moves: the right sides of the linear solves.

On the host: central differences between a case and the case moved along the column. Forces of muscles and weights
differ in float64 (sim/tangent/muscle_forces.py). The forces of the cloth are linear in its stiffnesses and in its rest
curvatures, each, so that a kernel may take their difference over changes of LARGE of a constant: the lanes'
constants move that far in the direction in which the column moves them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.acting import specimen_of
from fabdesign.effects.declaration import Specimen
from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Move
from fabdesign.nouns.forward import OF_MUSCLES, Case
from sim.grid import masses, muscle_masses
from sim.kernels.fields import LANES
from sim.lacing import touched
from sim.loading import constants_of, side_by_side
from sim.materials import CONSTANTS, REST_CURVATURES, Lane, M
from sim.tangent.muscle_forces import Grid, Pull, Strand, summed

LARGE = 0.5  # of a constant
CURVED = 20.0  # 1/m, what LARGE counts of where a curvature is zero
OF_SOLVER = "MEAN_MASS", "WEIGHT_TENSION"


class LaidCase:
    """A case as the forces take it, at rest under (channels,) Pa."""

    def __init__(self, case: Case, pressure: Array, n: int) -> None:
        self.case, self.pressure, self.n = case, pressure, n
        self.specimen = specimen_of(case)

    @cached_property
    def constants(self) -> Array:
        """Return the constants in the order of CONSTANTS; 0 for those that no force takes."""
        lane = Lane(self.specimen, self.n)
        return np.array([0.0 if name in OF_SOLVER else constant.value(lane) for name, constant in CONSTANTS.items()])

    @cached_property
    def mass(self) -> Array:
        """Return (n n,) kg"""
        return masses(self.specimen, self.n)

    @cached_property
    def gravity(self) -> Array:
        return np.array(self.specimen.design.fabric.gravity, dtype=float)

    @cached_property
    def strands(self) -> list[Strand]:
        design, numbers = self.specimen.design, self.specimen.muscles
        values = zip(*(numbers[name].tolist() for name in ("gain", "lever", "pressure_loss")), strict=True)
        return [
            Strand(muscle, design.muscle_types[muscle.type], float(self.pressure[muscle.channel]), *row)
            for muscle, row in zip(design.muscles, values, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class Sides:
    """A case moved to both sides along a column."""

    low: LaidCase
    high: LaidCase
    width: float  # between both, in the column's unit


@dataclass(frozen=True, eq=False)
class ClothChange:
    """How the lanes' constants move, and what forces at both sides are to be weighted by."""

    sides: tuple[NDArray[np.float32], NDArray[np.float32]]  # (blocks, constants, LANES) each
    weight: NDArray[np.float32]  # (blocks, LANES), of the second side; the first has the negative


class Explicit:
    """The lanes of a batch, and what columns change in them."""

    def __init__(self, lanes: Sequence[Case], n: int, pressure: Callable[[Case], Array]) -> None:
        self._n, self._pressure = n, pressure
        unique = {id(case): LaidCase(case, pressure(case), n) for case in {id(case): case for case in lanes}.values()}
        self._lanes = [unique[id(case)] for case in lanes]
        self._grid = Grid(n, *np.max([touched(case.design, n) for case in lanes], axis=0).tolist())
        fabrics = [lane.specimen.design.fabric for lane in self._lanes]
        self._spacing = np.array([(fabric.width, fabric.height) for fabric in fabrics]) / (n - 1)
        self.pressure = _by_lane([lane.pressure for lane in self._lanes])  # (blocks, channels, LANES) Pa
        self.constants = constants_of([lane.specimen for lane in self._lanes], n)

    def moved(self, moves: Sequence[Move | None]) -> list[Sides | None]:
        """Return both sides of a move for each lane; None where there is none."""
        return [
            None
            if change is None
            else Sides(self._side(lane, change.sides[0]), self._side(lane, change.sides[1]), change.width)
            for lane, change in zip(self._lanes, moves, strict=True)
        ]

    def _side(self, lane: LaidCase, case: Case) -> LaidCase:
        base = lane.case
        same = case.program is base.program and case.effects == base.effects
        return LaidCase(case, lane.pressure if same else self._pressure(case), self._n)

    def of_cloth(self, moved: Sequence[Sides | None]) -> ClothChange | None:
        """Return what one column changes in the lanes' cloths; None where that is nothing."""
        middle = np.array([lane.constants for lane in self._lanes])
        change, weight = np.zeros_like(middle), np.zeros(len(middle))
        for k, changed in enumerate(moved):
            if changed is None or _same_cloth(changed.low.specimen, changed.high.specimen):
                continue
            slope = (changed.high.constants - changed.low.constants) / changed.width
            largest = np.max(np.abs(slope) / self._scale[k], initial=0.0)
            if largest > 0:
                change[k], weight[k] = slope * LARGE / largest, largest / (2 * LARGE)
        if not weight.any():
            return None
        sides = side_by_side(list(middle - change)), side_by_side(list(middle + change))
        return ClothChange(sides, weight.reshape(-1, LANES).astype(np.float32))

    @cached_property
    def _scale(self) -> Array:
        """Return (lanes, constants) against which changes of a constant are large."""
        scale = np.abs([lane.constants for lane in self._lanes])
        scale[:, [M.CURVED1, M.CURVED2, M.CURVED12]] += CURVED
        scale[:, [M.GX, M.GY, M.GZ]] += 1.0
        return np.where(scale > 0, scale, 1.0)

    def of_muscles(self, columns: Sequence[Sequence[Sides | None]], middle: Array) -> NDArray[np.float32]:
        """Return (columns, lanes, n n, 3) N per unit: what each column changes in the lanes' muscles and weights, at
        their shapes, middle (lanes, n n, 3) m."""
        count = len(self._lanes)
        pulls: list[Pull] = []
        weights = np.zeros((len(columns) * count, *middle.shape[1:]))
        for slot, moved in enumerate(columns):
            for k, sides in enumerate(moved):
                if sides is None:
                    continue
                at = slot * count + k
                for strands, sign in zip(_unlike(sides.low, sides.high), (-1, 1), strict=True):
                    pulls += [Pull(strand, k, sign / sides.width, at) for strand in strands]
                change = self._mass_change(k, sides.low, sides.high)
                if change is not None:
                    weights[at] = change[:, None] / sides.width * self._lanes[k].gravity
        forces = weights + summed(pulls, middle, self._spacing, self._grid, len(weights))
        return forces.astype(np.float32).reshape(len(columns), count, *middle.shape[1:])

    def _mass_change(self, lane: int, low: LaidCase, high: LaidCase) -> Array | None:
        """Return (n n,) kg from one side to the other; None where none is."""
        if not _same_weight(low.specimen, high.specimen):
            return high.mass - low.mass
        one, other = low.specimen.design.muscles, high.specimen.design.muscles
        moved = [(a, b) for a, b in zip(one, other, strict=True) if a.path != b.path]
        if not moved:
            return None
        density = {name: kind.mass_per_length for name, kind in low.specimen.design.muscle_types.items()}
        changes = [(m, sign * density[m.type]) for pair in moved for m, sign in zip(pair, (-1, 1), strict=True)]
        return muscle_masses(changes, tuple(self._spacing[lane]), self._n)


def _unlike(low: LaidCase, high: LaidCase) -> tuple[list[Strand], list[Strand]]:
    """Return the muscles of both sides that do not pull alike."""
    pairs = [pair for pair in zip(low.strands, high.strands, strict=True) if not pair[0].is_like(pair[1])]
    return [one for one, _ in pairs], [other for _, other in pairs]


def _same_cloth(one: Specimen, other: Specimen) -> bool:
    """Return whether their constants are alike, but for those of the solver."""
    ours, others = ({k: v for k, v in s.factors.items() if k not in OF_MUSCLES} for s in (one, other))
    curved = all(one.constants.get(name) == other.constants.get(name) for name in REST_CURVATURES)
    return curved and ours == others and one.design.fabric is other.design.fabric


def _same_weight(one: Specimen, other: Specimen) -> bool:
    """Return whether they weigh the same, but for where their muscles lie."""
    factors = [specimen.factors.get("areal_density", 1.0) for specimen in (one, other)]
    return one.design.fabric is other.design.fabric and factors[0] == factors[1] and one.masses == other.masses


def _by_lane(pressures: Sequence[Array]) -> NDArray[np.float32]:
    channels = max(1, *map(len, pressures))
    return side_by_side([np.pad(pressure, (0, channels - len(pressure))) for pressure in pressures]).astype(np.float32)
