"""A specimen: a design as it really is, with scale factors and effects put into its constants."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.design import Design
from fabdesign.nouns.fabric import Fabric

Array = NDArray[np.float64]
OfPlace = Callable[[Array, Array], Array]  # of places (u, v) [m] on the flat cloth


@dataclass(frozen=True, eq=False)
class Specimen:
    """The constants and places that a simulation of one case is made of.

    muscles: (m,) numbers of every muscle by name: `gain` (on what pressure adds to the tension), `lever` (on the axis'
    offset), `pressure_loss` (share of the pressure lost from a muscle's first end to its last), and those that an
    effect's force asks for by its planes' names (zero where none says otherwise). constants: numbers of the whole
    specimen that a force asks for, by name; places: those that differ over the cloth, of which a node gets the mean
    over its area. masses: (u [m], v [m], kg) each, fixed to the cloth.
    """

    design: Design
    factors: Mapping[str, float]
    order: int = 0
    muscles: Mapping[str, Array] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)
    places: Mapping[str, OfPlace] = field(default_factory=dict)
    masses: tuple[tuple[float, float, float], ...] = ()

    def with_fabric(self, fabric: Fabric) -> "Specimen":
        return replace(self, design=replace(self.design, fabric=fabric))

    def with_muscles(self, where: NDArray[np.bool_], **values: float | Array) -> "Specimen":
        """Return the specimen whose muscles' numbers by name are these where `where` (m,) holds, one for all or
        (m,)."""
        count = len(self.design.muscles)
        changed = {
            name: np.where(where, value, self.muscles.get(name, np.zeros(count))) for name, value in values.items()
        }
        return replace(self, muscles={**self.muscles, **changed})

    def with_constants(self, **values: float) -> "Specimen":
        return replace(self, constants={**self.constants, **values})

    def with_place(self, name: str, value: OfPlace) -> "Specimen":
        return replace(self, places={**self.places, name: value})

    def with_mass(self, u: float, v: float, mass: float) -> "Specimen":
        return replace(self, masses=(*self.masses, (u, v, mass)))
