"""What a column changes before anything moves: a lane's constants, fixed points, masses and pressures, by differences.

On the host: a case and the case moved along the column are laid on the grid alike, and what differs is put into the
fields for one evaluation of the forces at the shape as it is.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.column import Move
from fabdesign.effects.acting import specimen_of
from fabdesign.effects.specimen import Specimen
from fabdesign.forward import Case
from sim import state
from sim.design.lacing import lace, touched
from sim.design.loading import fixed_points, muscle_table, node_values, side_by_side
from sim.kernels.fields import LANES
from sim.materials import Lane, lane_constants

Array = NDArray[np.float64]
Values = dict[str, NDArray]


class Laid:
    """Cases as the kernels take them, all with the batch's numbering of muscle types and size of loops."""

    def __init__(self, cases: Sequence[Case], n: int, pressure: Callable[[Case], Array]) -> None:
        self.n, self._pressure = n, pressure
        self._types = muscle_table(cases)
        self._size = np.max([touched(case.design, n) for case in cases], axis=0).tolist()

    def laid(self, case: Case, base: "LaidCase | None" = None) -> "LaidCase":
        """base: of a case that it may share arrays with, where nothing that they depend on differs."""
        specimen = specimen_of(case)
        values: Values = {"lane": lane_constants(Lane(specimen, self.n))}
        alike = base if base is not None and base.case.design.muscles == case.design.muscles else None
        if alike is not None and _same_cloth(specimen, alike.specimen):
            values |= {name: alike.values[name] for name in ("mass", *state.added("node"))}
        else:
            own = node_values(specimen, self.n)
            values |= {name: own[name] for name in ("mass", *state.added("node"))}
        if alike is not None and _same_muscles(specimen, alike.specimen):
            values |= {name: value for name, value in alike.values.items() if name not in values}
        else:
            lacing = lace(case.design, self.n, *self._size)
            values |= fixed_points(lacing, specimen, self._types, self.n)
        return LaidCase(case, specimen, values)

    def pressure(self, case: Case) -> Array:
        """(channels,) Pa that act at rest."""
        return self._pressure(case)


@dataclass(frozen=True, eq=False)
class LaidCase:
    """values: by name, as `put` takes them, of all that a column may move, which is not where nodes rest."""

    case: Case
    specimen: Specimen
    values: Values


@dataclass(frozen=True, eq=False)
class LaneChange:
    """What one evaluation puts in: values by name, pressures, and the weight of each lane's forces."""

    values: Mapping[str, NDArray]
    pressure: NDArray[np.float32]  # (blocks, channels, LANES) Pa
    weight: NDArray[np.float32]  # (blocks, LANES)


class Explicit:
    """The lanes of a batch, and each column that a lane takes as two changes of it."""

    def __init__(self, laid: Laid, lanes: Sequence[Case], channels: int) -> None:
        self._laid, self._channels = laid, channels
        own = {id(case): case for case in lanes}
        self.lanes = lanes
        self._own = {key: laid.laid(case) for key, case in own.items()}
        self._pressures = {key: laid.pressure(case) for key, case in own.items()}

    @property
    def pressure(self) -> NDArray[np.float32]:
        """(blocks, channels, LANES) Pa of the lanes as they are."""
        return self._side_by_side([self._pressures[id(case)] for case in self.lanes])

    def values(self, names: Sequence[str]) -> Values:
        """Of the lanes as they are."""
        return {name: side_by_side([self._own[id(case)].values[name] for case in self.lanes]) for name in names}

    def changes(self, moves: Sequence[Move | None]) -> list[LaneChange]:
        """For one move a lane, None where there is none: to one side, then to the other."""
        return [self._change(moves, side) for side in range(2)]

    def _change(self, moves: Sequence[Move | None], side: int) -> LaneChange:
        values, pressures, weights = [], [], []
        for case, own in zip(self.lanes, moves, strict=True):
            moved = case if own is None else own.sides[side]
            values.append(self._moved(case, moved))
            same = _same_pressures(case, moved)
            pressures.append(self._pressures[id(case)] if same else self._laid.pressure(moved))
            weights.append(0.0 if own is None else (2 * side - 1) / own.width)
        base = [self._own[id(case)].values for case in self.lanes]
        changed = [name for name in base[0] if any(v[name] is not b[name] for v, b in zip(values, base, strict=True))]
        weight = np.array(weights, np.float32).reshape(-1, LANES)
        return LaneChange(
            {name: side_by_side([v[name] for v in values]) for name in changed}, self._side_by_side(pressures), weight
        )

    def _moved(self, case: Case, moved: Case) -> Values:
        """The moved case's values, the very arrays of the case itself where they are equal."""
        base = self._own[id(case)]
        if moved.design is case.design and moved.factors == case.factors and moved.effects == case.effects:
            return base.values
        return {
            name: base.values[name] if np.array_equal(value, base.values[name]) else value
            for name, value in self._laid.laid(moved, base).values.items()
        }

    def _side_by_side(self, pressures: Sequence[Array]) -> NDArray[np.float32]:
        return side_by_side([np.pad(own, (0, self._channels - len(own))) for own in pressures]).astype(np.float32)


def _same_cloth(one: Specimen, other: Specimen) -> bool:
    """Whether their nodes are alike. What differs over the cloth is a function, of which nobody knows."""
    factors = [specimen.factors.get("areal_density", 1.0) for specimen in (one, other)]
    return (
        one.design is other.design
        and factors[0] == factors[1]
        and one.masses == other.masses
        and not one.places
        and not other.places
    )


def _same_muscles(one: Specimen, other: Specimen) -> bool:
    """Whether their fixed points are alike, for the same muscles."""
    return (
        one.factors.get("damping", 1.0) == other.factors.get("damping", 1.0)
        and one.muscles.keys() == other.muscles.keys()
        and all(np.array_equal(values, other.muscles[name]) for name, values in one.muscles.items())
    )


def _same_pressures(case: Case, moved: Case) -> bool:
    return moved.program is case.program and moved.effects == case.effects
