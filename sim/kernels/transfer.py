"""Between numpy and the fields: load a batch, halt it, read frames.

A loop that threads share costs 10 ms of every start, so short ones are serial.
"""

import taichi as ti

from sim.kernels.fields import LANES, C, F, H, Timed, X
from sim.kernels.vectors import Lanes, Wide

LOADED = 5  # planes of the node array that `load` takes: x, y, z, mass, free


@ti.kernel
def _load_kernel(
    nb: ti.i32, nu: ti.i32, nv: ti.i32, across: ti.i32, down: ti.i32, odd: ti.i32,
    basis: ti.types.ndarray(dtype=ti.f32, ndim=2),
    eigen: ti.types.ndarray(dtype=ti.f32, ndim=2),
    table: ti.types.ndarray(dtype=ti.f32, ndim=3),
    constants: ti.types.ndarray(dtype=ti.f32, ndim=3),
    node: ti.types.ndarray(dtype=ti.f32, ndim=4),
    point: ti.types.ndarray(dtype=ti.f32, ndim=3),
    index: ti.types.ndarray(dtype=ti.i32, ndim=4),
    weight: ti.types.ndarray(dtype=ti.f32, ndim=4),
    rows: ti.types.ndarray(dtype=ti.i32, ndim=3),
    shared: ti.types.ndarray(dtype=ti.f32, ndim=1),
    place: ti.types.ndarray(dtype=ti.i32, ndim=1),
    coarse: ti.types.ndarray(dtype=ti.f32, ndim=3),
):  # fmt: skip
    """What all designs share; then zero every other array, and to their places: constants (nb, constants, LANES),
    node (nb, 5, P, LANES), point (nb, first entries, LANES), index (nb, 3, points, LANES: base node,
    channel, type), weight (nb, 2, entries, LANES: F.across, F.down), rows (nb, points, 2)."""
    F.touched[0], F.touched[1], F.odd[None] = across, down, odd
    k = 0
    while k < F.after.shape[0]:
        F.after[k] = k + 1
        k += 1
    k = 0
    while k < basis.shape[0]:
        for r in ti.static(range(8)):
            F.basis[k][r] = basis[k, r]
        k = F.after[k]
    k = 0
    while k < eigen.shape[0]:
        for r in ti.static(range(3)):
            F.eigen[k][r] = eigen[k, r]
        k = F.after[k]
    k = 0
    while k < shared.shape[0]:
        C.shared[k] = shared[k]
        k = F.after[k]
    k = 0
    while k < place.shape[0]:
        C.place[k] = place[k]
        k = F.after[k]
    ti.loop_config(serialize=True)
    for t in range(table.shape[0]):
        for p in range(table.shape[1]):
            k = 0
            while k < table.shape[2]:
                F.table[t, p, k] = table[t, p, k]
                k = F.after[k]
    ti.loop_config(serialize=True)
    for b in range(nb):
        F.pairs[b] = 0
        P = (nu + 2) * (nv + 2)
        k = 0
        while k < F.node3.shape[1]:
            F.node3[b, k] = Wide(0.0)
            k = F.after[k]
        k = 0
        while k < F.mass:
            F.node[b, k] = Lanes(0.0)
            k = F.after[k]
        k = 0
        while k < F.modal3.shape[1]:  # a product with a zero entry of the basis must not meet an old NaN
            F.modal3[b, k] = Wide(0.0)
            k = F.after[k]
        put_constants(b, constants)
        lane = 0
        while lane < LANES:
            k = 0
            while k < P:
                c = 0
                while c < 3:
                    F.node3[b, F.x0 + k][c * LANES + lane] = node[b, c, k, lane]
                    F.node3[b, F.q + k][c * LANES + lane] = node[b, c, k, lane]
                    c = F.after[c]
                F.node[b, F.mass + k][lane] = node[b, 3, k, lane]
                F.node[b, F.free + k][lane] = node[b, 4, k, lane]
                k = F.after[k]
            k = 0
            while k < point.shape[1]:
                F.point[b, k][lane] = point[b, k, lane]
                k = F.after[k]
            k = 0
            while k < index.shape[2]:
                F.base[b, k][lane] = index[b, 0, k, lane]
                F.channel[b, k][lane] = index[b, 1, k, lane]
                F.kind[b, k][lane] = index[b, 2, k, lane]
                k = F.after[k]
            k = 0
            while k < weight.shape[2]:
                F.across[b, k][lane] = weight[b, 0, k, lane]
                F.down[b, k][lane] = weight[b, 1, k, lane]
                k = F.after[k]
            k = 0
            while k < coarse.shape[1]:
                F.coarse_down[b, k][lane] = coarse[b, k, lane]
                k = F.after[k]
            lane = F.after[lane]
        k = 0
        while k < rows.shape[1]:
            F.rows[b, k][0] = rows[b, k, 0]
            F.rows[b, k][1] = rows[b, k, 1]
            k = F.after[k]


@ti.kernel
def _constants_kernel(nb: ti.i32, constants: ti.types.ndarray(dtype=ti.f32, ndim=3)):
    ti.loop_config(serialize=True)
    for b in range(nb):
        put_constants(b, constants)


@ti.func
def put_constants(b, constants: ti.template()):
    """constants (nb, constants, LANES) of one block."""
    lane = 0
    while lane < LANES:
        k = 0
        while k < constants.shape[1]:
            F.lane[b, k][lane] = constants[b, k, lane]
            k = F.after[k]
        lane = F.after[lane]


@ti.kernel
def _halt_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32):
    """Zero velocity and acceleration."""
    ti.loop_config(serialize=True)
    for b in range(nb):
        k = 0
        while k < (nu + 2) * (nv + 2):
            F.node3[b, F.v0 + k] = Wide(0.0)
            F.node3[b, F.a0 + k] = Wide(0.0)
            k = F.after[k]


@ti.kernel
def _read_kernel(nb: ti.i32, nu: ti.i32, nv: ti.i32, plane: ti.i32, out: ti.types.ndarray(dtype=ti.f32, ndim=4)):
    """out (nb, LANES, nu nv, 3): positions in a plane of F.node3."""
    for b in range(nb):
        for lane in range(LANES):
            for j in range(nv):
                i = 0
                while i < nu:
                    for c in range(3):
                        out[b, lane, j * nu + i, c] = F.node3[b, plane + (j + 1) * (nu + 2) + i + 1][c * LANES + lane]
                    i = F.after[i]


@ti.func
def record(b, nu, nv, npt, lane, theta, frame, shapes: ti.template(), states: ti.template()):
    """shapes (frames, nu nv, 3): positions at the fraction theta of the last step, cubic Hermite; states (frames,
    npt, 2): contraction and tension [N] of every interval at its evaluation point."""
    h = F.scheme[b, H][lane]
    b1 = (1 - theta) * (1 - theta) * theta * h
    b2 = theta * theta * (3 - 2 * theta)
    b3 = theta * theta * (theta - 1) * h
    for j in range(nv):
        i = 0
        while i < nu:
            k = (j + 1) * (nu + 2) + i + 1
            for c in range(3):
                e = c * LANES + lane
                old = F.node3[b, F.xp + k][e]
                new = F.node3[b, F.x0 + k][e]
                shapes[frame, j * nu + i, c] = (
                    old + b2 * (new - old) + b1 * F.node3[b, F.vp + k][e] + b3 * F.node3[b, F.v0 + k][e]
                )
            i = F.after[i]
    k = 0
    while k < npt:
        states[frame, k, 0] = F.point[b, X.eps + k][lane]
        states[frame, k, 1] = F.point[b, X.tension + k][lane]
        k = F.after[k]


load, load_materials, halt, read = (
    Timed(_load_kernel),
    Timed(_constants_kernel),
    Timed(_halt_kernel),
    Timed(_read_kernel),
)
