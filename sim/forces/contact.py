"""Contact of the cloth with itself: nodes against the cells of other layers, as penalties.

Equations 13-14 of docs/model.md. Which nodes meet which cells, where and from which side, is found between steps
(sim/forces/contact_pairs.py); the forces below belong to the positions of the evaluation, so that the step stays
implicit.
"""

import taichi as ti

from sim.kernels.fields import LANES, F, Timed
from sim.state import PAIR


@ti.func
def contact(b, nu):
    """f += forces of all pairs; there are none where self_contact is off."""
    k = 0
    while k < F.pairs[b]:
        lane = 0
        while lane < LANES:
            if F.pair[b, PAIR * k + 4][lane] > 0:  # a spare entry of this lane has no stiffness
                press(b, nu + 2, k, lane)
            lane = F.after[lane]
        k = F.after[k]


@ti.func
def press(b, row, k, lane):
    """The node and the four corners of the cell are pushed apart along the cell's normal; as the energy's whole
    gradient, that of the normal too, these five forces have neither a sum nor a moment."""
    xi = F.pair[b, PAIR * k][lane]
    eta = F.pair[b, PAIR * k + 1][lane]
    side = F.pair[b, PAIR * k + 2][lane]
    i = F.pair_node[b, k][lane]
    c = F.pair_cell[b, k][lane]
    x00, x10 = place(b, c, lane), place(b, c + 1, lane)
    x01, x11 = place(b, c + row, lane), place(b, c + row + 1, lane)
    w10, w01, w11 = xi * (1 - eta), (1 - xi) * eta, xi * eta
    w00 = 1 - w10 - w01 - w11
    apart = place(b, i, lane) - w00 * x00 - w10 * x10 - w01 * x01 - w11 * x11
    along = 0.5 * (x10 - x00 + x11 - x01)
    down = 0.5 * (x01 - x00 + x11 - x10)
    area = down.cross(along)
    size = area.norm() + 1e-12
    n = area / size
    depth = F.pair[b, PAIR * k + 3][lane] - side * n.dot(apart)
    if depth > 0:
        force = F.pair[b, PAIR * k + 4][lane] * depth * side
        push(b, i, lane, force * n)
        # what turning the normal does to the gap: apart . dn = lever . d(down x along)
        lever = 0.5 * force / size * (apart - n.dot(apart) * n)
        p, q = lever.cross(down), along.cross(lever)
        push(b, c, lane, -w00 * force * n - p - q)
        push(b, c + 1, lane, -w10 * force * n + p - q)
        push(b, c + row, lane, -w01 * force * n - p + q)
        push(b, c + row + 1, lane, -w11 * force * n + p + q)


@ti.func
def place(b, k, lane):
    e = F.q + k
    return ti.Vector([F.node3[b, e][lane], F.node3[b, e][LANES + lane], F.node3[b, e][2 * LANES + lane]])


@ti.func
def push(b, k, lane, force):
    for c in ti.static(range(3)):
        F.node3[b, F.f + k][c * LANES + lane] += force[c]


@ti.kernel
def _put_kernel(
    nb: ti.i32, index: ti.types.ndarray(dtype=ti.i32, ndim=4), value: ti.types.ndarray(dtype=ti.f32, ndim=4)
):
    """index (nb, 2, pairs, LANES): node and first corner of the cell, with padding; value (nb, PAIR, pairs, LANES)."""
    for b in range(nb):
        F.pairs[b] = index.shape[2]
        for lane in range(LANES):
            k = 0
            while k < index.shape[2]:
                F.pair_node[b, k][lane] = index[b, 0, k, lane]
                F.pair_cell[b, k][lane] = index[b, 1, k, lane]
                for e in range(PAIR):
                    F.pair[b, PAIR * k + e][lane] = value[b, e, k, lane]
                k = F.after[k]


put = Timed(_put_kernel)
