"""From designs to the numbers that the kernels take: grid, materials, mass, laced fixed points, bench tables."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.fabric import Fabric
from fabdesign.least_squares import non_negative
from fabdesign.muscle import BenchTable
from fabdesign.muscle_law import MuscleLaw
from sim import fields as f
from sim.loops import line_weights, patch_size

Array = NDArray[np.float64]
HUNG = {"top": 0, "bottom": 1, "left": 2, "right": 3, "none": 4}
FREE = HUNG["none"]  # also: held at points


@dataclass(frozen=True, eq=False)
class Lacing:
    """The fixed points of one design on an n x n grid; interval k runs from point k to k + 1 where `active`."""

    base: NDArray[np.int32]  # (p, 2) row and column of the first node
    weights: Array  # (6, p, PATCH): wu, wv, du, dv, eu, ev, zeros behind
    offset: Array  # (p,) m, signed: positive on the front
    active: Array  # (p,) 1 where an interval starts
    rest: Array  # (p,) m
    channel: NDArray[np.int32]  # (p,)
    kind: tuple[str, ...]  # (p,) muscle type


def hung_code(fabric: Fabric) -> int:
    """Of HUNG; held at points is free to the preconditioner."""
    return HUNG[fabric.hung] if isinstance(fabric.hung, str) else FREE


def touched(design: Design, n: int) -> tuple[int, int]:
    """How many nodes across and down a loop of this design can touch."""
    return patch_size(n, design.fabric.width / (n - 1)), patch_size(n, design.fabric.height / (n - 1))


def lace(design: Design, n: int, across: int, down: int) -> Lacing:
    """The fixed points with the weights of across x down nodes around each."""
    hu, hv = design.fabric.width / (n - 1), design.fabric.height / (n - 1)
    weights = [np.zeros((6, 0, f.PATCH))]
    base: list[tuple[int, int]] = []
    offset, active, rest, channel, kind = [], [], [], [], []
    for muscle in design.muscles:
        points = muscle.fixed_points()
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        side = 1.0 if muscle.side == "front" else -1.0
        i, wu, du, eu = line_weights(points[:, 0], n, hu, across)
        j, wv, dv, ev = line_weights(points[:, 1], n, hv, down)
        base += zip(j, i, strict=True)
        touching = np.zeros((6, len(points), f.PATCH))
        touching[::2, :, :across], touching[1::2, :, :down] = (wu, du, eu), (wv, dv, ev)
        weights.append(touching)
        for q in range(len(points)):
            offset.append(side * design.muscle_types[muscle.type].axis_offset)
            last = q == len(points) - 1
            active.append(0.0 if last else 1.0)
            rest.append(1.0 if last else lengths[q])
            channel.append(muscle.channel)
            kind.append(muscle.type)
    return Lacing(
        np.array(base, np.int32).reshape(-1, 2), np.concatenate(weights, axis=1),
        np.array(offset), np.array(active), np.array(rest), np.array(channel, np.int32), tuple(kind),
    )  # fmt: skip


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
    """(LANE_CONSTANTS,) materials and geometry of one design, in the order of sim.fields."""
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


def node_arrays(design: Design, factors: Mapping[str, float], n: int) -> tuple[Array, Array, Array]:
    """Rest positions (n n, 3) m, lumped masses (n n,) kg and free (n n,), rows of rising v."""
    fabric = design.fabric
    u, v = np.linspace(0, fabric.width, n), np.linspace(0, fabric.height, n)
    uu, vv = np.meshgrid(u, v)
    rest = np.stack([uu - fabric.width / 2, -vv, np.zeros_like(uu)], axis=-1).reshape(-1, 3)
    trapezoid = np.ones(n)
    trapezoid[[0, -1]] = 0.5
    cell = u[1] * v[1]
    mass = factors.get("areal_density", 1.0) * fabric.areal_density * cell * np.outer(trapezoid, trapezoid)
    for muscle in design.muscles:
        _add_line_mass(mass, muscle.path, design.muscle_types[muscle.type].mass_per_length, u[1], v[1])
    free = np.ones((n, n))
    if not isinstance(fabric.hung, str):
        for pu, pv in fabric.hung:
            free[round(pv / v[1]), round(pu / u[1])] = 0
    elif fabric.hung != "none":
        free[{"top": (0,), "bottom": (-1,), "left": (slice(None), 0), "right": (slice(None), -1)}[fabric.hung]] = 0
    return rest, mass.ravel(), free.ravel()


def _add_line_mass(mass: Array, path: tuple[tuple[float, float], ...], density: float, hu: float, hv: float) -> None:
    corners = np.array(path)
    for a, b in pairwise(corners):
        length = float(np.linalg.norm(b - a))
        samples = max(2, int(np.ceil(4 * length / min(hu, hv))))
        share = (np.arange(samples) + 0.5) / samples
        x, y = ((a + (b - a) * share[:, None]) / (hu, hv)).T
        i, j = (np.minimum(t.astype(int), n - 2) for t, n in ((x, mass.shape[1]), (y, mass.shape[0])))
        for row, down in ((j, j + 1 - y), (j + 1, y - j)):
            for column, across in ((i, i + 1 - x), (i + 1, x - i)):
                np.add.at(mass, (row, column), down * across * (density * length / samples))


@lru_cache(maxsize=64)
def bench_grid(table: BenchTable) -> NDArray[np.float32]:
    """(pressures, contractions) N: the muscle law on the kernels' grid."""
    pressure = np.arange(f.TABLE[0])[:, None] * f.PRESSURE_STEP
    contraction = f.FIRST_CONTRACTION + np.arange(f.TABLE[1]) * f.CONTRACTION_STEP
    return MuscleLaw.fit(table).tension(pressure, contraction[None]).astype(np.float32)
