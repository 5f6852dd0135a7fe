"""A force with memory, as a newcomer would add one: creep of the cloth with two internal strains, along v.

An edge of strain e pulls with K (e - z_1 - z_2), where tau_i d z_i / d t = s_i e - z_i; off where s_1 = s_2 = 0.
"""

import taichi as ti

from sim.forces.memory import ForceWithMemory
from sim.kernels.fields import F
from sim.kernels.vectors import thrice
from sim.materials import Constant, M
from sim.state import REMEMBERED, Plane
from sim.time.scheme import AGES

TIMES = 0.1, 0.5  # s


@ti.func
def _aged(before, limit, ages, tau):
    return before + (1.0 - ti.exp(-ages / tau)) * (limit - before)


@ti.func
def _creep(b, nu, nv, npt):
    ages = F.scheme[b, AGES]
    for j in range(nv - 1):
        i = 0
        while i < nu:
            k = (j + 1) * (nu + 2) + i + 1
            strain = F.node[b, F.ev + k]
            one = _aged(F.node[b, F.creep_1 + k], F.lane[b, M.CREEP_1] * strain, ages, TIMES[0])
            two = _aged(F.node[b, F.creep_2 + k], F.lane[b, M.CREEP_2] * strain, ages, TIMES[1])
            F.node[b, F.creep_1_next + k] = one
            F.node[b, F.creep_2_next + k] = two
            share = 0.5 if i == 0 or i == nu - 1 else 1.0
            lost = share * F.lane[b, M.K2] * F.lane[b, M.HU] * (one + two)  # N
            F.node3[b, F.f + k] -= thrice(lost) * F.node3[b, F.tv + k]
            F.node3[b, F.f + k + nu + 2] += thrice(lost) * F.node3[b, F.tv + k]
            i = F.after[i]


CREEP = ForceWithMemory(
    _creep,
    planes=tuple(Plane(f"creep_{i}", "edge", "1", REMEMBERED, f"internal strain {i} along v") for i in (1, 2)),
    constants={
        f"CREEP_{i}": Constant("1", f"share s_{i} of the strain", lambda c, i=i: c.factors.get(f"creep_{i}", 0.0))
        for i in (1, 2)
    },
)
