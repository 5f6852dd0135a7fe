"""Forces with memory: creep, friction, relaxation, whatever depends on what was.

A force with memory is one file of its own: its planes of memory, its constants, and one function of Taichi,

    force(b, nu, nv, npt)

which adds to F.f what pulls at the nodes of block b at the positions F.q and velocities F.v (and, of what the forces of
cloth and muscles leave, strains F.eu and F.ev, tangents F.tu and F.tv, contractions X.eps, ...). It is called in every
evaluation of a step. Each time it takes the memory from F.NAME as the step before left it, ages it by the seconds
F.scheme[b, AGES], and writes the result to F.NAME_next: that becomes F.NAME when the step is done (`remember`), so that
nothing ages by being evaluated twice. AGES is the step in a motion, zero on the way to where a motion starts, and 1e9 s
in an equilibrium, so use a form that has both limits, such as 1 - exp(-AGES / tau). What a constant of the lane makes
zero must add zero: lanes with and without the force ride in one block.

Limits: the preconditioner does not know the force, so that a stiff one costs iterations; memory ages by whole steps
with the strain of the evaluation, of first order in the step.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import taichi as ti

from sim import materials, state
from sim.kernels.fields import F, X
from sim.materials import Constant
from sim.state import NEXT, Plane


@dataclass(frozen=True)
class ForceWithMemory:
    """Declares its planes and constants; step.py sums its force. One object for each force: kernels are compiled for
    it."""

    force: Callable[..., Any]  # a function of Taichi, as above
    planes: tuple[Plane, ...]  # remembered
    constants: Mapping[str, Constant] = field(default_factory=dict, hash=False)  # M.NAME, from the case

    def __post_init__(self) -> None:
        if any(plane.life != state.REMEMBERED for plane in self.planes):
            raise ValueError("planes of a force with memory must be remembered")
        state.declare(*self.planes)
        for name, constant in self.constants.items():
            materials.declare(name, constant)


@ti.func
def remember(b):
    """At a step's end: memory is what the last evaluation left."""
    for plane in ti.static(state.remembered("node")):
        keep(b, F.node, ti.static(getattr(F, plane.name)), ti.static(getattr(F, plane.name + NEXT)), F.nodes)
    for plane in ti.static(state.remembered("node3")):
        keep(b, F.node3, ti.static(getattr(F, plane.name)), ti.static(getattr(F, plane.name + NEXT)), F.nodes)
    for plane in ti.static(state.remembered("point")):
        keep(b, F.point, ti.static(getattr(X, plane.name)), ti.static(getattr(X, plane.name + NEXT)), F.points)
    for plane in ti.static(state.remembered("point3")):
        keep(b, F.point3, ti.static(getattr(X, plane.name)), ti.static(getattr(X, plane.name + NEXT)), F.points)


@ti.func
def keep(b, field: ti.template(), memory, successor, count):
    k = 0
    while k < count:
        field[b, memory + k] = field[b, successor + k]
        k = F.after[k]
