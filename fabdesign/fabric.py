"""The cloth: an elastic orthotropic sheet, by its declared (data sheet) values."""

from dataclasses import dataclass
from typing import Literal

from fabdesign.curve_file import MembraneCurve

Edge = Literal["top", "bottom", "left", "right", "none"]


@dataclass(frozen=True)
class Fabric:
    """A rectangle of cloth, how it is held and what pulls on it.

    Direction 1 is across (u), 2 is down (v). `poisson` is nu_12; nu_21 = nu_12 k_2 / k_1.
    """

    width: float  # m, across
    height: float  # m, down
    thickness: float  # m, between the faces
    areal_density: float  # kg/m^2, without muscles
    membrane_stiffness: tuple[float, float]  # N/m, uniaxial tension per strain with free sides
    shear_stiffness: float  # N/m, tension per engineering shear angle
    poisson: float  # nu_12
    bending_stiffness: tuple[float, float]  # N m, moment per width over curvature of a strip with free sides
    twist_stiffness: float | None = None  # N m, twist moment over twist curvature; None: B / (1 + nu)
    viscosity: float = 0.0  # N s/m, Kelvin-Voigt
    air_damping: float = 0.0  # N s/m^3
    support: Literal["pinned", "clamped"] = "pinned"
    hung: Edge | tuple[tuple[float, float], ...] = "top"  # an edge, or (u, v) points in m
    gravity: tuple[float, float, float] = (0.0, -9.81, 0.0)  # m/s^2
    membrane_curve: MembraneCurve | None = None  # replaces a membrane stiffness, per direction
