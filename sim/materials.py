"""Constants of a lane: materials and geometry of one design, by name, with unit and formula.

Kernels read them as F.lane[b, M.NAME]; the symbols are those of docs/model.md.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from fabdesign.effects.declaration import Specimen
from fabdesign.geometry.curves import non_negative
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric
from sim.grid import Support


def bending_rigidities(fabric: Fabric) -> tuple[float, float, float, float]:
    """Return D_1, D_2, D_12 and the twist stiffness [N m]: the strip of each direction keeps its declared B."""
    b1, b2 = fabric.bending_stiffness
    k1, k2 = fabric.membrane_stiffness
    nu2 = fabric.poisson**2 * k2 / k1  # nu_12 nu_21
    d1, d2 = b1 / (1 - nu2), b2 / (1 - nu2)
    twist = fabric.twist_stiffness
    if twist is None:
        twist = float(np.sqrt(b1 * b2) / (1 + np.sqrt(nu2)))
    return d1, d2, float(np.sqrt(nu2 * d1 * d2)), twist


def membrane_polynomial(fabric: Fabric, direction: int) -> tuple[float, float, float]:
    """Return k, q, r [N/m] of T = k e + q e^2 + r e^3 for e > 0, k e below: linear, or fits a J-shaped curve."""
    curve = fabric.membrane_curve
    if curve is None or not curve.strain[direction]:
        return fabric.membrane_stiffness[direction], 0.0, 0.0
    strain, tension = np.array(curve.strain[direction]), np.array(curve.tension[direction])
    k, q, r = non_negative(np.stack([strain, strain**2, strain**3], axis=1), tension)
    return float(k), float(q), float(r)


# constants of a specimen: curvatures of the free cloth [1/m], along u, along v and its twist
REST_CURVATURES = "rest_curvature_across", "rest_curvature_down", "rest_curvature_twist"


@dataclass(frozen=True)
class Lane:
    """A specimen on an n x n grid."""

    specimen: Specimen
    n: int

    def factor(self, name: str) -> float:
        """Return the scale factor on a declared value."""
        return self.specimen.factors.get(name, 1.0)

    def constant(self, name: str) -> float:
        """Return a constant that an effect gives to the whole specimen; 0 where none does."""
        return self.specimen.constants.get(name, 0.0)

    @property
    def fabric(self) -> Fabric:
        return self.specimen.design.fabric

    @property
    def support(self) -> Support:
        return Support.of(self.fabric)

    @property
    def spacing(self) -> tuple[float, float]:
        """Return m, along u and v"""
        return self.fabric.width / (self.n - 1), self.fabric.height / (self.n - 1)

    @cached_property
    def membrane(self) -> tuple[float, float, float]:
        """Return K_1, K_2, K_12 [N/m]"""
        (k1, _, _), (k2, _, _) = self.polynomials
        nu21 = self.fabric.poisson * k2 / k1
        scale = self.factor("membrane") / (1 - self.fabric.poisson * nu21)
        return scale * k1, scale * k2, scale * nu21 * k1

    @cached_property
    def polynomials(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        return membrane_polynomial(self.fabric, 0), membrane_polynomial(self.fabric, 1)

    @cached_property
    def bending(self) -> tuple[float, float, float, float]:
        """Return D_1, D_2, D_12 and twist [N m]"""
        d1, d2, d12, twist = (self.factor("bending") * d for d in bending_rigidities(self.fabric))
        return d1, d2, d12, twist

    @cached_property
    def mean_mass(self) -> float:
        """Return kg/m^2, muscles and added masses included"""
        design = self.specimen.design
        laced = sum(design.muscle_types[m.type].mass_per_length * m.length for m in design.muscles)
        cloth = self.factor("areal_density") * self.fabric.areal_density
        added = sum(mass for _, _, mass in self.specimen.masses)
        return cloth + (laced + added) / (self.fabric.width * self.fabric.height)

    @property
    def weight_tension(self) -> float:
        """Return N/m, mean tension of a cloth under its weight, hung by its top"""
        if self.support != Support.TOP:
            return 0.0
        return max(0.0, -0.5 * self.mean_mass * self.fabric.gravity[1] * self.fabric.height)


@dataclass(frozen=True)
class Constant:
    unit: str
    what: str
    value: Callable[[Lane], float]


CONSTANTS: dict[str, Constant] = {
    "HU": Constant("m", "h_1, spacing along u", lambda c: c.spacing[0]),
    "HV": Constant("m", "h_2, spacing along v", lambda c: c.spacing[1]),
    "IHU": Constant("1/m", "1 / h_1", lambda c: 1 / c.spacing[0]),
    "IHV": Constant("1/m", "1 / h_2", lambda c: 1 / c.spacing[1]),
    "AREA": Constant("m^2", "h_1 h_2, of a cell", lambda c: c.spacing[0] * c.spacing[1]),
    "K1": Constant("N/m", "K_1, membrane along u", lambda c: c.membrane[0]),
    "K2": Constant("N/m", "K_2, membrane along v", lambda c: c.membrane[1]),
    "K12": Constant("N/m", "K_12, membrane, coupled", lambda c: c.membrane[2]),
    "Q1": Constant("N/m", "q_1, of a membrane curve", lambda c: c.factor("membrane") * c.polynomials[0][1]),
    "R1": Constant("N/m", "r_1, of a membrane curve", lambda c: c.factor("membrane") * c.polynomials[0][2]),
    "Q2": Constant("N/m", "q_2, of a membrane curve", lambda c: c.factor("membrane") * c.polynomials[1][1]),
    "R2": Constant("N/m", "r_2, of a membrane curve", lambda c: c.factor("membrane") * c.polynomials[1][2]),
    "S": Constant("N/m", "S, shear", lambda c: c.factor("shear") * c.fabric.shear_stiffness),
    "B1": Constant("N m", "B_1, of a strip along u", lambda c: c.factor("bending") * c.fabric.bending_stiffness[0]),
    "B2": Constant("N m", "B_2, of a strip along v", lambda c: c.factor("bending") * c.fabric.bending_stiffness[1]),
    "D1": Constant("N m", "D_1, bending along u", lambda c: c.bending[0]),
    "D2": Constant("N m", "D_2, bending along v", lambda c: c.bending[1]),
    "D12": Constant("N m", "D_12, bending, coupled", lambda c: c.bending[2]),
    "T": Constant("N m", "T, twist", lambda c: c.bending[3]),
    # of the free cloth, by an effect
    "CURVED1": Constant("1/m", "curvature along u", lambda c: c.constant(REST_CURVATURES[0])),
    "CURVED2": Constant("1/m", "curvature along v", lambda c: c.constant(REST_CURVATURES[1])),
    "CURVED12": Constant("1/m", "twist", lambda c: c.constant(REST_CURVATURES[2])),
    "VISCOSITY": Constant("N s/m", "of strain", lambda c: c.factor("damping") * c.fabric.viscosity),
    "AIR": Constant("N s/m^3", "c, air damping", lambda c: c.factor("damping") * c.fabric.air_damping),
    # three in this order, one vector
    "GX": Constant("m/s^2", "gravity along x", lambda c: c.fabric.gravity[0]),
    "GY": Constant("m/s^2", "gravity along y", lambda c: c.fabric.gravity[1]),
    "GZ": Constant("m/s^2", "gravity along z", lambda c: c.fabric.gravity[2]),
    # of the solver's flat cloth
    "MEAN_MASS": Constant("kg/m^2", "muscles and added masses included", lambda c: c.mean_mass),
    "WEIGHT_TENSION": Constant("N/m", "mean, of a cloth hung by its top", lambda c: c.weight_tension),
    "TOP_HELD": Constant("1", "1 where the top edge is held", lambda c: float(c.support == Support.TOP)),
    "BOTTOM_HELD": Constant("1", "1 where the bottom edge is held", lambda c: float(c.support == Support.BOTTOM)),
    "CLAMPED": Constant("1", "1 where the held edge is clamped", lambda c: float(c.fabric.support == "clamped")),
}


class Numbers(SimpleNamespace):
    """The number of each constant, by name."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> int: ...


M = Numbers(**{name: index for index, name in enumerate(CONSTANTS)})


def declare(name: str, constant: Constant) -> None:
    """Declare one more, by an effect's own file: before the first batch, or the fields are made anew."""
    if CONSTANTS.setdefault(name, constant) is not constant:
        raise ValueError(f"constant {name!r}: there is one of this name already")
    setattr(M, name, list(CONSTANTS).index(name))


def lane_constants(lane: Lane) -> Array:
    """Return (constants,) of one design, in the order of CONSTANTS."""
    return np.array([constant.value(lane) for constant in CONSTANTS.values()])
