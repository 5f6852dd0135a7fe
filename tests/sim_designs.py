"""Cloths and cases for the tests of the simulator."""

from dataclasses import replace

import numpy as np

from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import Case
from fabdesign.nouns.muscle import BenchTable, Muscle, MuscleType
from fabdesign.nouns.pressure import PressureProgram

CLOTH = Fabric(
    width=0.2,
    height=0.2,
    thickness=0.002,
    areal_density=0.6,
    membrane_stiffness=(520.0, 520.0),
    shear_stiffness=130.0,
    poisson=0.25,
    bending_stiffness=(0.006, 0.006),
    viscosity=6.0,
    air_damping=0.5,
)


def cloth(*muscles: Muscle, types=None, **changes) -> Design:
    """A design on CLOTH with changed values."""
    return Design("test", replace(CLOTH, **changes), types or {}, muscles)


def linear_muscle(stiffness: float, pull: float, **changes) -> MuscleType:
    """A massless type whose law is F = pull p / 100 kPa - stiffness contraction [N]."""
    rows = [(p, e) for p in (0.0, 100e3, 200e3, 300e3, 400e3) for e in np.linspace(-0.1, 0.3, 9)]
    table = BenchTable(
        tuple(p for p, _ in rows), tuple(e for _, e in rows), tuple(pull * p / 100e3 - stiffness * e for p, e in rows)
    )
    return replace(MuscleType("linear", 0.002, 0.0, 0.001, table), **changes)


def held(design: Design, kpa=(), **factors: float) -> Case:
    """Constant pressures [kPa] from rest."""
    pressure = np.array(kpa, float).reshape(1, -1) * 1e3
    return Case(design, PressureProgram(np.zeros(1), pressure, 1.5), factors)


def laced(layout="basic", muscles=4, fixed_point_pitch=0.02, **changes) -> Design:
    """A catalogue layout on CLOTH with changed values."""
    return build(layout, muscles=muscles, fabric=replace(CLOTH, **changes), fixed_point_pitch=fixed_point_pitch)


def rolled(bending=6e-4, height=0.26) -> Case:
    """A cloth of a tenth of the bending stiffness, without gravity, hung by its top, which four front muscles roll up:
    their pressures rise to 400 kPa within half a second."""
    design = laced("vertical", 4, bending_stiffness=(bending, bending), height=height, gravity=(0.0, 0.0, 0.0))
    time = np.arange(31) / 60
    pressure = 400e3 * np.minimum(1, 2 * (time + 1 / 60))
    return Case(design, PressureProgram(time, np.repeat(pressure[:, None], 4, axis=1), 2.0), {})


def middle(points):
    """(41, 41, 3) mid-surface of one frame's faces (3362, 3)."""
    return points.astype(float).reshape(2, 41, 41, 3).mean(0)


def around(ends, spacing):
    """The nodes that a loop at each of `ends` touches: 3 x 3, `spacing` apart."""
    offsets = (-spacing, 0.0, spacing)
    return tuple((u + du, v + dv) for u, v in ends for dv in offsets for du in offsets)
