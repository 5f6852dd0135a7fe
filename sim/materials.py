"""Materials and geometry of a lane: the constants that its kernels take."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.fabric import Fabric
from fabdesign.least_squares import non_negative
from sim.design.support import hung_code
from sim.kernels import fields as f

Array = NDArray[np.float64]


def bending_rigidities(fabric: Fabric) -> tuple[float, float, float, float]:
    """D_1, D_2, D_12 and the twist stiffness [N m]: the strip of each direction keeps its declared B."""
    b1, b2 = fabric.bending_stiffness
    k1, k2 = fabric.membrane_stiffness
    nu2 = fabric.poisson**2 * k2 / k1  # nu_12 nu_21
    d1, d2 = b1 / (1 - nu2), b2 / (1 - nu2)
    twist = fabric.twist_stiffness
    if twist is None:
        twist = float(np.sqrt(b1 * b2) / (1 + np.sqrt(nu2)))
    return d1, d2, float(np.sqrt(nu2 * d1 * d2)), twist


def membrane_polynomial(fabric: Fabric, direction: int) -> tuple[float, float, float]:
    """k, q, r [N/m] of T = k e + q e^2 + r e^3 for e > 0, k e below: linear, or fits a J-shaped curve."""
    curve = fabric.membrane_curve
    if curve is None or not curve.strain[direction]:
        return fabric.membrane_stiffness[direction], 0.0, 0.0
    strain, tension = np.array(curve.strain[direction]), np.array(curve.tension[direction])
    k, q, r = non_negative(np.stack([strain, strain**2, strain**3], axis=1), tension)
    return float(k), float(q), float(r)


def lane_constants(design: Design, factors: Mapping[str, float], n: int) -> Array:
    """(LANE_CONSTANTS,) materials and geometry of one design, in the order of sim.kernels.fields."""
    fabric = design.fabric
    hu, hv = fabric.width / (n - 1), fabric.height / (n - 1)
    membrane, bending = factors.get("membrane", 1.0), factors.get("bending", 1.0)
    damping, density = factors.get("damping", 1.0), factors.get("areal_density", 1.0)
    (k1, q1, r1), (k2, q2, r2) = (membrane_polynomial(fabric, d) for d in (0, 1))
    nu21 = fabric.poisson * k2 / k1
    scale = membrane / (1 - fabric.poisson * nu21)
    d1, d2, d12, twist = (bending * d for d in bending_rigidities(fabric))
    laced = sum(design.muscle_types[m.type].mass_per_length * m.length for m in design.muscles)
    mass = density * fabric.areal_density + laced / (fabric.width * fabric.height)
    hung = hung_code(fabric)
    c = np.zeros(f.LANE_CONSTANTS)
    c[[f.HU, f.HV, f.IHU, f.IHV, f.AREA]] = hu, hv, 1 / hu, 1 / hv, hu * hv
    c[[f.KH1, f.KH2, f.K12, f.SH]] = (
        scale * k1,
        scale * k2,
        scale * nu21 * k1,
        factors.get("shear", 1.0) * fabric.shear_stiffness,
    )
    c[[f.Q1, f.R1, f.Q2, f.R2]] = membrane * np.array([q1, r1, q2, r2])
    c[[f.D1, f.D2, f.D12, f.TW]] = d1, d2, d12, twist
    c[[f.B1, f.B2]] = bending * np.array(fabric.bending_stiffness)
    c[[f.VISC, f.AIR]] = damping * fabric.viscosity, damping * fabric.air_damping
    c[[f.GX, f.GY, f.GZ]] = fabric.gravity
    c[f.MBAR], c[f.DTOP], c[f.DBOT] = mass, hung == 0, hung == 1
    c[f.TG] = max(0.0, -0.5 * mass * fabric.gravity[1] * fabric.height) if hung == 0 else 0.0
    c[f.DCLAMP] = fabric.support == "clamped"
    return c
