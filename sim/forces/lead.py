"""Springs and dampers that lead the cloth along one that was seen, by its normals: a force that is known, so that what
it takes is known too (fabdesign/nouns/lead.py)."""

from collections.abc import Callable, Sequence

import numpy as np
import taichi as ti

from fabdesign.nouns.array import Array
from fabdesign.nouns.column import SPRINGS
from fabdesign.nouns.lead import DAMPERS, Lead, share
from sim.forces.added import AddedForce
from sim.kernels.fields import LANES, F, indices
from sim.kernels.transfer import put
from sim.kernels.vectors import sum3, thrice
from sim.loading import by_blocks, ringed
from sim.state import LOADED, Plane

AT_ONCE = 64  # steps, whose places are made together


@ti.func
def _pull(b, nu, nv, npt):
    most = ti.f32(0.0)
    for lane in indices(LANES):
        most = ti.max(most, F.node[b, F.led + nu + 3][lane])  # of all nodes alike
    if most > 0.0:
        for j in range(nv):
            for i in indices(nu):
                k = (j + 1) * (nu + 2) + i + 1
                normal = F.node3[b, F.n + k]
                off = SPRINGS * (F.node3[b, F.lead + k] - F.node3[b, F.q + k]) - DAMPERS * F.node3[b, F.v + k]
                along = F.node[b, F.led + k] * F.node[b, F.mass + k] * sum3(off * normal)
                F.node3[b, F.f + k] += thrice(along) * normal


LEAD = AddedForce(
    cloth=_pull, planes=(Plane("led", "node", "1", LOADED, "share of the springs and dampers that lead"),)
)


def leading(
    grid: tuple[int, int, int], lanes: Sequence[int], leads: Sequence[Lead | None], instants: Sequence[Array]
) -> Callable[[int], None]:
    """Return what puts into the fields where springs lead in a step, by its number. grid: blocks, nu, nv. lanes: which
    of the leads each has; None leads nowhere. instants: (S,) s of each, at which its steps are evaluated."""
    blocks, nu, nv = grid
    at_once: list[tuple[Array, Array]] = []

    def put_before(step: int) -> None:
        k = step % AT_ONCE
        if k == 0:
            numbers = step + np.arange(AT_ONCE)
            each = [some[np.minimum(numbers, len(some) - 1)] for some in instants]
            at_once[:] = [_places(lead, times, (nv, nu, 3)) for lead, times in zip(leads, each, strict=True)]
        place = ringed(np.array([at_once[i][0][k] for i in lanes]))
        led = np.repeat([[at_once[i][1][k]] for i in lanes], (nv + 2) * (nu + 2), axis=1)
        put(blocks, {"lead": place, "led": by_blocks(led.astype(np.float32))})

    return put_before


def _places(lead: Lead | None, times: Array, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Return (T, n, n, 3) m where a lead pulls to, and (T,) the share of its springs."""
    if lead is None:
        return np.zeros((len(times), *shape)), np.zeros(len(times))
    return lead.ahead(times), share(times)
