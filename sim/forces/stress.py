"""The cloth's elastic stress under two effects: places are stiffer, and part of it relaxes.

Each stress s of the cloth (tension of an edge, moments of a node, shear and twist of a cell, equations 2 to 6 of
docs/model.md, without viscosity) becomes (1 + a) s - share q, where dq/dt = ((1 + a) s - q) / time: a is what a place
is stiffer by, share and time are one Prony term's. A cloth that rests has relaxed. The forces of the cloth ask for it
where a batch has added forces (`stressed` in sim/forces/cloth.py): in all of its lanes, so that each keeps its bits.
"""

import taichi as ti

from sim.forces.added import AddedForce, aged
from sim.kernels.fields import LANES, F
from sim.materials import Constant, M
from sim.state import LOADED, REMEMBERED, Plane
from sim.time.scheme import AGES


@ti.func
def age_stress(b):
    """Return by how much memory follows in this step."""
    share = aged(b, F.lane[b, M.RELAXED_TIME])
    lane = 0
    while lane < LANES:
        if F.scheme[b, AGES][lane] == 0.0:  # on the way to where a motion starts
            share[lane] = 1.0
        lane = F.after[lane]
    F.aged[b, 0] = share


@ti.func
def relaxes(b):
    """Return whether stress relaxes in any lane."""
    most = ti.f32(0.0)
    lane = 0
    while lane < LANES:
        most = ti.max(most, F.lane[b, M.RELAXED_SHARE][lane])
        lane = F.after[lane]
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
