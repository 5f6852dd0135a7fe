"""An effect of one's own: creep of the cloth along v, with two internal strains.

    fabdesign simulate design.toml --pressures 200 --model model.toml --effects examples/cloth_creep.py -o motion.npz

where model.toml says `[[effects]]`, `name = "cloth_creep"`. An edge of strain e pulls with K (e - z_1 - z_2), where
tau_i d z_i / d t = s_i e - z_i; off where s_1 = s_2 = 0.
"""

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from fabdesign.effects import Effect, EffectParameter, Specimen
from fabdesign.effects.declaration import Values
from sim.forces.added import AddedForce
from sim.kernels.fields import F, indices
from sim.kernels.vectors import thrice
from sim.materials import Constant, M
from sim.state import REMEMBERED, Plane
from sim.time_steps import AGES

TIMES = 0.1, 0.5  # s


@ti.func
def _aged(before, limit, ages, tau):
    return before + (1.0 - ti.exp(-ages / tau)) * (limit - before)


@ti.func
def _creep(b, nu, nv, npt):
    ages = F.scheme[b, AGES]
    for j in range(nv - 1):
        for i in indices(nu):
            k = (j + 1) * (nu + 2) + i + 1
            strain = F.node[b, F.ev + k]
            one = _aged(F.node[b, F.cloth_creep_1 + k], F.lane[b, M.CLOTH_CREEP_1] * strain, ages, TIMES[0])
            two = _aged(F.node[b, F.cloth_creep_2 + k], F.lane[b, M.CLOTH_CREEP_2] * strain, ages, TIMES[1])
            F.node[b, F.cloth_creep_1_next + k] = one
            F.node[b, F.cloth_creep_2_next + k] = two
            share = 0.5 if i == 0 or i == nu - 1 else 1.0
            lost = share * F.lane[b, M.K2] * F.lane[b, M.HU] * (one + two)  # N
            F.node3[b, F.f + k] -= thrice(lost) * F.node3[b, F.tv + k]
            F.node3[b, F.f + k + nu + 2] += thrice(lost) * F.node3[b, F.tv + k]


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_constants(cloth_creep_1=values["share_1"], cloth_creep_2=values["share_2"])


CLOTH_CREEP = Effect(
    "cloth_creep",
    site="fabric",
    scope="fabric",
    what="part of the cloth's strain along v comes slowly, with 0.1 and 0.5 s",
    signature="the cloth grows longer at hold, most near the hung edge",
    source="generalised Kelvin-Voigt solid",
    parameters={
        "share_1": EffectParameter("1", "of the strain, within 0.1 s", 0.15, (0.0, 0.9), 0.1, off=0.0),
        "share_2": EffectParameter("1", "of the strain, within 0.5 s", 0.25, (0.0, 0.9), 0.1, off=0.0),
    },
    specimen=_specimen,
    force=AddedForce(
        cloth=_creep,
        planes=tuple(
            Plane(f"cloth_creep_{i}", "edge", "1", REMEMBERED, f"internal strain {i} along v") for i in (1, 2)
        ),
        constants={
            f"CLOTH_CREEP_{i}": Constant("1", f"share s_{i}", lambda c, i=i: c.constant(f"cloth_creep_{i}"))
            for i in (1, 2)
        },
    ),
    remembers=True,
)
