"""The change of the forces by a column before anything moves: the right sides of the linear solves.

On the host: central differences between a case and the case moved along the column. Forces of muscles and weights
differ in float64 (sim/tangent/muscle_forces.py). The forces of the cloth are linear in its stiffnesses and in its rest
curvatures, each, so that a kernel may take their difference over changes of LARGE of a constant: the lanes'
constants move that far in the direction in which the column moves them.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.acting import specimen_of
from fabdesign.effects.declaration import MuscleRecord, Specimen
from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Column, Course, move
from fabdesign.nouns.forward import OF_MUSCLES, Case
from sim.grid import masses, muscle_masses
from sim.kernels.fields import LANES
from sim.lacing import touched
from sim.loading import constants_of, side_by_side
from sim.materials import CONSTANTS, REST_CURVATURES, Lane, M
from sim.tangent.memory import Memory, felt
from sim.tangent.muscle_forces import Grid, Pull, Strand, summed

LARGE = 0.5  # of a constant
CURVED = 20.0  # 1/m, what LARGE counts of where a curvature is zero
OF_SOLVER = "MEAN_MASS", "WEIGHT_TENSION"


class LaidCase:
    """A case as the forces take it, under (channels,) Pa, or (ticks, channels) Pa of a motion, which muscles
    remember."""

    def __init__(self, case: Case, pressure: Array, n: int, memory: Memory | None = None) -> None:
        self.case, self.pressure, self.n, self.memory = case, pressure, n, memory
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
    def _pulls(self) -> list[list[float]]:
        numbers = self.specimen.muscles
        return [
            list(row)
            for row in zip(*(numbers[name].tolist() for name in ("gain", "lever", "pressure_loss")), strict=True)
        ]

    def at(self, tick: int | None) -> Array:
        """Return (channels,) Pa, at a tick of a motion."""
        return self.pressure if tick is None else self.pressure[tick]

    def strands(self, tick: int | None) -> list[Strand]:
        design, pressure = self.specimen.design, self.at(tick)
        strands = [
            Strand(muscle, design.muscle_types[muscle.type], float(pressure[muscle.channel]), *row)
            for muscle, row in zip(design.muscles, self._pulls, strict=True)
        ]
        if tick is None or self.memory is None or not self._remembered:
            return strands
        then = [felt(record, tick * self.memory.tick) for record in self._remembered]
        return [replace(one, lent=lent, friction=of) for one, (lent, of) in zip(strands, then, strict=True)]

    def pulls_like(self, other: "LaidCase") -> bool:
        """Return whether all muscles pull alike in another case, at any tick."""
        one, another = self.specimen.design, other.specimen.design
        same = one.muscles is another.muscles and one.muscle_types is another.muscle_types
        same = same and self._pulls == other._pulls and np.array_equal(self.pressure, other.pressure)
        return same and (self.memory is None or self._remembered is other._remembered)

    @cached_property
    def _remembered(self) -> list[MuscleRecord]:
        return [] if self.memory is None else self.memory.of(self.case)


class Sides(NamedTuple):
    """A case moved to both sides along a column."""

    low: LaidCase
    high: LaidCase
    width: float  # between both, in the column's unit
    pulls_alike: bool  # whether all muscles pull alike on both


class MovedCases:
    """Cases on n x n grids, each moved along columns, once. pressure(case): what LaidCase takes. courses: of the cases,
    where they move; tick: s, of their pressures."""

    def __init__(
        self,
        cases: Sequence[Case],
        columns: Sequence[Column],
        n: int,
        pressure: Callable[[Case], Array],
        *,
        courses: Sequence[Course] = (),
        tick: float = 0.0,
    ) -> None:
        self._columns, self._n, self._pressure = columns, n, pressure
        self.laid = [LaidCase(case, pressure(case), n) for case in cases]
        for laid, course in zip(self.laid, courses, strict=False):
            laid.memory = Memory(laid.specimen, course, laid.pressure, tick)
        self._sides: dict[tuple[int, int], Sides] = {}

    def sides(self, case: int, column: int) -> Sides:
        """Return both sides of a case along a column, by their numbers."""
        if (case, column) not in self._sides:
            base, moving = self.laid[case], self._columns[column]
            move_of = move(base.case, moving, moving.step)
            low, high = (self._side(base, side) for side in move_of.sides)
            self._sides[case, column] = Sides(low, high, move_of.width, low.pulls_like(high))
        return self._sides[case, column]

    def _side(self, base: LaidCase, case: Case) -> LaidCase:
        same = case.program is base.case.program and case.effects == base.case.effects
        return LaidCase(case, base.pressure if same else self._pressure(case), self._n, base.memory)


class LaneColumns(NamedTuple):
    """The content of a lane, by numbers: a case, and which of the columns are solved there. tick: of a motion, and
    (n, n, 3) m/s^2 its acceleration then; at rest neither."""

    case: int
    columns: tuple[int, ...]
    tick: int | None = None
    acceleration: Array | None = None


class Explicit:
    """The lanes of a batch, and what columns change in them."""

    def __init__(self, moved: MovedCases, lanes: Sequence[LaneColumns], n: int) -> None:
        self._moved, self._columns, self._n = moved, lanes, n
        self._lanes = [moved.laid[lane.case] for lane in lanes]
        self._grid = Grid(n, *np.max([touched(laid.case.design, n) for laid in self._lanes], axis=0).tolist())
        fabrics = [laid.specimen.design.fabric for laid in self._lanes]
        self._spacing = np.array([(fabric.width, fabric.height) for fabric in fabrics]) / (n - 1)
        self.pressure = _by_lane([laid.at(lane.tick) for laid, lane in zip(self._lanes, lanes, strict=True)])
        self.constants = constants_of([laid.specimen for laid in self._lanes], n)

    @property
    def masses(self) -> list[Array]:
        """Return (n n,) kg of each lane."""
        return [laid.mass for laid in self._lanes]

    @property
    def remembered(self) -> dict[str, NDArray[np.float32]]:
        """Return what the muscles of each lane remember, by the plane of the fields."""
        lanes = [laid.strands(lane.tick) for laid, lane in zip(self._lanes, self._columns, strict=True)]
        counts = [[len(strand.muscle.fixed_points()) for strand in strands] for strands in lanes]
        room = max(map(sum, counts))

        def plane(of: Callable[[Strand], float | Array]) -> NDArray[np.float32]:
            """Return (blocks, points, LANES); an interval has the place of its first fixed point."""
            return side_by_side(
                [_by_interval(map(of, strands), some, room) for strands, some in zip(lanes, counts, strict=True)]
            )

        return {"held_lent": plane(lambda one: one.lent), "held_friction": plane(lambda one: one.friction)}

    def moved(self, slot: int) -> list[Sides | None]:
        """Return both sides of each lane along the column in a slot of its own; None where there is none."""
        return [
            self._moved.sides(lane.case, lane.columns[slot]) if slot < len(lane.columns) else None
            for lane in self._columns
        ]

    def of_cloth(self, moved: Sequence[Sides | None]) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """Return what one column changes in the lanes' cloths: constants (blocks, constants, LANES) of both sides, and
        (blocks, LANES) by what forces there are to be weighted; nothing where it changes nothing."""
        middle = np.array([lane.constants for lane in self._lanes])
        change, weight = np.zeros_like(middle), np.zeros(len(middle))
        for k, changed in enumerate(moved):
            if changed is None or _same_cloth(changed.low.specimen, changed.high.specimen):
                continue
            slope = (changed.high.constants - changed.low.constants) / changed.width
            largest = np.max(np.abs(slope) / self._scale[k], initial=0.0)
            if largest > 0:
                change[k], weight[k] = slope * LARGE / largest, largest / (2 * LARGE)
        weights = weight.reshape(-1, LANES).astype(np.float32)
        return [(side_by_side(list(middle + sign * change)), sign * weights) for sign in (-1, 1) if weights.any()]

    def of_damping(self, moved: Sequence[Sides | None]) -> Array:
        """Return (lanes,) by which share a unit of one column changes the viscous forces: all go by one factor."""
        shares = np.zeros(len(self._lanes))
        for k, sides in enumerate(moved):
            if sides is not None:
                low, high = (one.case.factors.get("damping", 1.0) for one in (sides.low, sides.high))
                shares[k] = (high - low) / sides.width / max(0.5 * (high + low), 1e-9)
        return shares

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
                at, tick = slot * count + k, self._columns[k].tick
                for strands, sign in zip(_unlike(sides, tick), (-1, 1), strict=True):
                    pulls += [Pull(strand, k, sign / sides.width, at) for strand in strands]
                change = self._mass_change(k, sides.low, sides.high)
                if change is not None:
                    weights[at] = change[:, None] / sides.width * self._felt(k)
        forces = weights + summed(pulls, middle, self._spacing, self._grid, len(weights))
        return forces.astype(np.float32).reshape(len(columns), count, *middle.shape[1:])

    def _felt(self, lane: int) -> Array:
        """Return (3,) or (n n, 3) m/s^2 that masses feel: gravity less the acceleration."""
        gravity = np.array(self._lanes[lane].specimen.design.fabric.gravity, dtype=float)
        acceleration = self._columns[lane].acceleration
        return gravity if acceleration is None else np.asarray(gravity - acceleration.reshape(-1, 3))

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


def _by_interval(values: Iterable[float | Array], counts: Sequence[int], room: int) -> Array:
    """Return (room,): a value of each muscle's intervals, or (k,) of each, at the places of their first of `counts`
    fixed points."""
    spread = [np.broadcast_to(value, count - 1) for value, count in zip(values, counts, strict=True)]
    every = np.concatenate([np.zeros(0), *(np.append(some, 0.0) for some in spread)])
    return np.pad(every, (0, room - len(every)))


def _unlike(sides: Sides, tick: int | None) -> tuple[list[Strand], list[Strand]]:
    """Return the muscles of both sides that do not pull alike."""
    if sides.pulls_alike:
        return [], []
    strands = sides.low.strands(tick), sides.high.strands(tick)
    pairs = [pair for pair in zip(*strands, strict=True) if not pair[0].is_like(pair[1])]
    return [one for one, _ in pairs], [other for _, other in pairs]


def _same_cloth(one: Specimen, other: Specimen) -> bool:
    """Return whether their constants are alike, but for those of the solver and of damping."""
    elsewhere = ("damping", *OF_MUSCLES)
    ours, others = ({k: v for k, v in s.factors.items() if k not in elsewhere} for s in (one, other))
    curved = all(one.constants.get(name) == other.constants.get(name) for name in REST_CURVATURES)
    return curved and ours == others and one.design.fabric is other.design.fabric


def _same_weight(one: Specimen, other: Specimen) -> bool:
    """Return whether they weigh the same, but for where their muscles lie."""
    factors = [specimen.factors.get("areal_density", 1.0) for specimen in (one, other)]
    return one.design.fabric is other.design.fabric and factors[0] == factors[1] and one.masses == other.masses


def _by_lane(pressures: Sequence[Array]) -> NDArray[np.float32]:
    channels = max(1, *map(len, pressures))
    return side_by_side([np.pad(pressure, (0, channels - len(pressure))) for pressure in pressures]).astype(np.float32)
