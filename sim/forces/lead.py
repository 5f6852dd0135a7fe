"""Springs and dampers that lead the cloth along one that was seen, by its normals: a force that is known, so that what
it takes is known too (fabdesign/nouns/lead.py)."""

from collections.abc import Callable, Sequence

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.column import SPRINGS
from fabdesign.nouns.lead import DAMPERS, Lead, share
from sim.kernels.fields import LANES, WIDE, F, indices
from sim.kernels.vectors import sum3, thrice
from sim.loading import ringed
from sim.time_steps import LED

Places = Callable[[int, int], NDArray[np.float32]]  # of steps begin to end


@ti.func
def largest_share(b):
    """Return the largest share of the lanes' springs in a step."""
    most = ti.f32(0.0)
    for lane in indices(LANES):
        most = ti.max(most, F.scheme[b, LED][lane])
    return most


@ti.func
def lead_to(b, m, nodes, places: ti.template()):
    """Put where springs lead the cloth in step m."""
    if largest_share(b) > 0.0:
        for k in indices(nodes):
            for c in indices(WIDE):
                F.node3[b, F.lead + k][c] = places[m, b, k, c]


@ti.func
def pull_ahead(b, nu, nv):
    if largest_share(b) > 0.0:
        for j in range(nv):
            for i in indices(nu):
                k = (j + 1) * (nu + 2) + i + 1
                normal = F.node3[b, F.n + k]
                off = SPRINGS * (F.node3[b, F.lead + k] - F.node3[b, F.q + k]) - DAMPERS * F.node3[b, F.v + k]
                along = F.scheme[b, LED] * F.node[b, F.mass + k] * sum3(off * normal)
                F.node3[b, F.f + k] += thrice(along) * normal


def leading(
    grid: tuple[int, int, int], lanes: Sequence[int], leads: Sequence[Lead | None], instants: Sequence[Array]
) -> tuple[Array, Places]:
    """Return (S, blocks, LANES), the share of the springs in each step, and what gives (steps, blocks, nodes, WIDE) m,
    where they lead in steps begin to end. grid: blocks, nu, nv. lanes: which of the leads each has; None leads nowhere.
    instants: (up to S,) s of each, at which its steps are evaluated; a lane goes on as in its last."""
    blocks, nu, nv = grid
    steps = max(map(len, instants))
    at = [np.pad(times, (0, steps - len(times)), mode="edge") for times in instants]
    led = {i: (lead, times) for i, (lead, times) in enumerate(zip(leads, at, strict=True)) if lead is not None}
    shares = np.zeros((steps, len(leads)))
    for i, (_, times) in led.items():
        shares[:, i] = share(times)

    def places(begin: int, end: int) -> NDArray[np.float32]:
        each = np.zeros((len(leads), end - begin, nv, nu, 3))
        for i, (lead, times) in led.items():
            each[i] = lead.ahead(times[begin:end])
        of_lanes = each[[*lanes]].swapaxes(0, 1)
        return np.array([ringed(step).reshape(blocks, -1, WIDE) for step in of_lanes])

    return shares[:, [*lanes]].reshape(steps, blocks, LANES), places
