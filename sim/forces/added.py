"""Forces that effects add to a step: creep, friction, drag, whatever the cloth and its muscles have not of their own.

An added force is one file: its planes, its constants, and functions of Taichi at one or more of four places of a step,
each but the first evaluated as often as a step is, lanes side by side:

    pressure(b, k)          the pressure that acts in interval k [Pa], from F.point[b, X.pressure + k], once a step
    cloth(b, nu, nv, npt)   adds to F.f what pulls at the nodes at positions F.q and velocities F.v (and strains F.eu,
                            tangents F.tu, normals F.n, contractions X.eps, ... as cloth and muscles leave them)
    lent(b, k)              contraction of interval k that the bench law does not see, and its derivative by contraction
    tension(b, k)           tension added to that of interval k [N], and the stiffness -dT/d(contraction) it adds [N]

Memory: a plane NAME declared as REMEMBERED holds it as the step before left it. A function ages it by the seconds
F.scheme[b, AGES] and writes the result to NAME_next, in every evaluation anew: that becomes NAME when the step is done
(`remember`), so that nothing ages by being evaluated twice. AGES is the step in a motion, zero on the way to where a
motion starts, and as long as the rise and the hold of an equilibrium take over its few steps, so use a form that long
steps leave stable: `aged`, 1 - exp(-AGES / tau). What a constant or a loaded plane makes zero must add zero: lanes with
and without a force may ride in one block.

What changes the elastic stress of the cloth is asked for where the cloth's own forces are made: `stressed`
(sim/forces/added.py).

Limits: the preconditioner knows the stiffness of `tension` and `lent`, not that of `cloth`; memory ages by whole steps
with the state of the evaluation, of first order in the step.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import taichi as ti

from sim import materials, state
from sim.kernels.fields import LANES, F, X, indices
from sim.materials import Constant, M
from sim.state import LOADED, NEXT, REMEMBERED, Plane
from sim.time_steps import AGES

SHORTEST = 1e-6  # s, of a time constant


@dataclass(frozen=True)
class AddedForce:
    """Declares its planes and constants; step.py calls its functions. One object for each force: kernels are compiled
    for it."""

    pressure: Callable[..., Any] | None = None  # functions of Taichi, as above
    cloth: Callable[..., Any] | None = None
    lent: Callable[..., Any] | None = None
    tension: Callable[..., Any] | None = None
    stressed: bool = False
    # remembered ones, and loaded ones: on intervals numbers of the specimen's muscles, on nodes of its places, by name
    planes: tuple[Plane, ...] = ()
    constants: Mapping[str, Constant] = field(default_factory=dict, hash=False)  # M.NAME, from the specimen

    @property
    def has_cloth_memory(self) -> bool:
        """Return whether `cloth` may write memory, so that it is asked once more where a step ends."""
        return self.cloth is not None and any(plane.life == state.REMEMBERED for plane in self.planes)

    def __post_init__(self) -> None:
        for plane in self.planes:
            if plane.life == state.LOADED and plane.on not in ("interval", "node"):
                raise ValueError(f"plane {plane.name}: on {plane.on}; what an effect loads is on intervals or nodes")
            if plane.life not in (state.LOADED, state.REMEMBERED):
                raise ValueError(f"plane {plane.name}: planes of an added force are loaded or remembered")
        state.declare(*self.planes)
        for name, constant in self.constants.items():
            materials.declare(name, constant)


@ti.func
def aged(b, time):
    """Share by which a memory with this time constant [s] follows in a step."""
    return 1.0 - ti.exp(-F.scheme[b, AGES] / ti.max(time, SHORTEST))


@ti.func
def remember(b):
    """Keep memory at a step's end: it is what the last evaluation left."""
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
    for k in indices(count):
        field[b, memory + k] = field[b, successor + k]


@ti.func
def age_stress(b):
    """Return by how much memory follows in this step."""
    share = aged(b, F.lane[b, M.RELAXED_TIME])
    for lane in indices(LANES):
        if F.scheme[b, AGES][lane] == 0.0:  # on the way to where a motion starts
            share[lane] = 1.0
    F.aged[b, 0] = share


@ti.func
def relaxes(b):
    """Return whether stress relaxes in any lane."""
    most = ti.f32(0.0)
    for lane in indices(LANES):
        most = ti.max(most, F.lane[b, M.RELAXED_SHARE][lane])
    return most > 0.0


@ti.func
def stiffer(b, first, second):
    """1 + a, the mean of two nodes."""
    return 1.0 + 0.5 * (F.node[b, F.stiffer + first] + F.node[b, F.stiffer + second])


@ti.func
def relaxed(b, memory, successor, stress):
    """Return what remains at the step's end of a stress, whose memory the entries of F.node are."""
    gone = F.node[b, memory] + F.aged[b, 0] * (stress - F.node[b, memory])
    F.node[b, successor] = gone
    return stress - F.lane[b, M.RELAXED_SHARE] * gone


@ti.func
def relaxed_more(b, successor, stress):
    """Return what remains of what adds to a stress that `relaxed` was asked for."""
    gone = F.aged[b, 0] * stress
    F.node[b, successor] += gone
    return stress - F.lane[b, M.RELAXED_SHARE] * gone


CLOTH_STRESS = AddedForce(
    stressed=True,
    planes=(
        Plane("stiffer", "node", "1", LOADED, "what its place is stiffer by"),
        Plane("relaxed_u", "edge", "N m", REMEMBERED, "tension along u times area that has relaxed, over the share"),
        Plane("relaxed_v", "edge", "N m", REMEMBERED, "the same along v"),
        Plane("relaxed_1", "node", "N m", REMEMBERED, "of the moment along u times area over spacing"),
        Plane("relaxed_2", "node", "N m", REMEMBERED, "of the moment along v times area over spacing"),
        Plane("relaxed_shear", "cell", "N m", REMEMBERED, "of the shear times area"),
        Plane("relaxed_twist", "cell", "N", REMEMBERED, "of the twist's pull"),
        Plane("relaxed_clamp", "node", "N m", REMEMBERED, "of the moment at a clamped edge times width"),
    ),
    constants={
        "RELAXED_SHARE": Constant("1", "of the cloth's stress, in the end", lambda c: c.constant("relaxed_share")),
        "RELAXED_TIME": Constant("s", "its time constant", lambda c: c.constant("relaxed_time")),
    },
)
