"""The global solve that preconditions every iteration (docs/model.md, section Solver)."""

import taichi as ti

from sim.fields import (
    AIR,
    B2,
    D1,
    D2,
    D12,
    DBOT,
    DCLAMP,
    DTOP,
    GREEN,
    HU,
    HV,
    IHU,
    IHV,
    KH1,
    KH2,
    LANES,
    MBAR,
    SH,
    TG,
    TW,
    VISC,
    F,
    X,
)
from sim.lacing import gather, interp

Lanes = ti.types.vector(LANES, ti.f32)


@ti.func
def factor(b, nu, nv, ca, cv):
    """LDL^T in v of every u-mode: planes 0,1 u-comp (l, 1/d); 2,3 v-comp; 4,5,6 normal (l1,l2,1/d)"""
    N = nu * nv
    vis = F.lane[b, VISC] * cv
    mb = F.lane[b, MBAR] * ca + F.lane[b, AIR] * cv
    hu = F.lane[b, HU]
    hv = F.lane[b, HV]
    ihu = F.lane[b, IHU]
    ihv = F.lane[b, IHV]
    k1 = F.lane[b, KH1] + vis
    k2 = F.lane[b, KH2] + vis
    sh = F.lane[b, SH] + 0.5 * vis
    free_top = 1.0 - F.lane[b, DTOP]
    for j in range(nv):
        wj = ti.f32(1.0)
        kj = ti.f32(2.0)
        bj = ti.f32(6.0)
        b1 = ti.f32(-4.0)
        if j == 0 or j == nv - 1:
            wj = ti.f32(0.5)
            kj = ti.f32(1.0)
            bj = ti.f32(1.0)
        if j == 1 or j == nv - 2:
            bj = ti.f32(5.0)
        if j == 1 or j == nv - 1:
            b1 = ti.f32(-2.0)
        for k_ in range(nu):
            k = F.index[k_]
            lam = F.eigen[k]
            o = j * nu + k
            fm = Lanes(1.0)
            fm2 = Lanes(1.0)
            own = Lanes(0.0)
            if j == 0:
                own = F.lane[b, DTOP]
            if j == nv - 1:
                own = F.lane[b, DBOT]
                fm = 1.0 - F.lane[b, DBOT]
                fm2 = fm
            extra = Lanes(0.0)
            if j == 1:
                fm = free_top
                extra = F.lane[b, DTOP] * F.lane[b, DCLAMP] * 2.0 * hu * F.lane[b, B2] * ihv * ihv * ihv
            if j == 2:
                fm2 = free_top
            au = (1.0 - own) * ((hu * mb + k1 * lam * ihu) * wj * hv + hu * sh * kj * ihv) + own
            av = (1.0 - own) * ((hu * mb + sh * lam * ihu) * wj * hv + hu * k2 * kj * ihv) + own
            tw = 2.0 * (F.lane[b, D12] + F.lane[b, TW]) * lam * ihu
            an = (1.0 - own) * (
                (hu * mb + F.lane[b, D1] * lam * lam * ihu * ihu * ihu) * wj * hv
                + (hu * F.lane[b, TG] + tw) * kj * ihv
                + hu * F.lane[b, D2] * bj * ihv * ihv * ihv
                + extra
            ) + own
            if j == 0:
                F.factor[b, N + o] = 1.0 / au
                F.factor[b, 3 * N + o] = 1.0 / av
                F.factor[b, 6 * N + o] = 1.0 / an
                F.factor[b, o] = Lanes(0.0)
                F.factor[b, 2 * N + o] = Lanes(0.0)
                F.factor[b, 4 * N + o] = Lanes(0.0)
                F.factor[b, 5 * N + o] = Lanes(0.0)
            else:
                eu = -fm * hu * sh * ihv
                ev = -fm * hu * k2 * ihv
                lu = eu * F.factor[b, N + o - nu]
                lv = ev * F.factor[b, 3 * N + o - nu]
                F.factor[b, o] = lu
                F.factor[b, 2 * N + o] = lv
                F.factor[b, N + o] = 1.0 / (au - lu * eu)
                F.factor[b, 3 * N + o] = 1.0 / (av - lv * ev)
                e1 = fm * (-(hu * F.lane[b, TG] + tw) * ihv + hu * F.lane[b, D2] * b1 * ihv * ihv * ihv)
                if j == 1:
                    l1 = e1 * F.factor[b, 6 * N + o - nu]
                    F.factor[b, 4 * N + o] = l1
                    F.factor[b, 5 * N + o] = Lanes(0.0)
                    F.factor[b, 6 * N + o] = 1.0 / (an - l1 * e1)
                else:
                    e2 = fm2 * hu * F.lane[b, D2] * ihv * ihv * ihv
                    l2 = e2 * F.factor[b, 6 * N + o - 2 * nu]
                    g1 = e1 - l2 * F.factor[b, 4 * N + o - nu] / F.factor[b, 6 * N + o - 2 * nu]
                    l1 = g1 * F.factor[b, 6 * N + o - nu]
                    F.factor[b, 4 * N + o] = l1
                    F.factor[b, 5 * N + o] = l2
                    F.factor[b, 6 * N + o] = 1.0 / (an - l1 * g1 - l2 * e2)


@ti.func
def butterfly(b, nu, row):
    """Entries i and nu - 1 - i of a row of F.modal become their sum and difference, where the basis has odd vectors."""
    for i_ in range(F.odd[None]):
        i = F.index[row + i_]
        k = F.index[row + nu - 1 - i_]
        x = F.modal[b, i]
        y = F.modal[b, k]
        F.modal[b, i] = x + y
        F.modal[b, k] = x - y


@ti.func
def transform(b, nu, nv, src, dst, inverse, c0, c1):
    """F.modal[dst] = F.modal[src] by rows times the basis across (its transpose where inverse = 1); even and odd vectors
    apart. Spends src."""
    for j in range(c0 * nv, c1 * nv):
        o = j * nu
        if inverse == 0:
            butterfly(b, nu, src + o)
        for part in range(2):
            first = 0
            count = nu - F.odd[None]
            C = inverse * (count * count + F.odd[None] * F.odd[None])
            if part == 1:
                C += count * count
                first = count
                count = F.odd[None]
            for k_ in range(count):
                k = F.index[dst + o + first + k_]
                F.modal[b, k] = Lanes(0.0)
            for i4 in range(count // 4):
                i = src + o + first + i4 * 4
                g0 = F.modal[b, i]
                g1 = F.modal[b, i + 1]
                g2 = F.modal[b, i + 2]
                g3 = F.modal[b, i + 3]
                for k_ in range(count):
                    k = F.index[k_]
                    m = C + i4 * 4 * count + k
                    F.modal[b, dst + o + first + k] = (
                        F.modal[b, dst + o + first + k]
                        + (F.basis[m] * g0 + F.basis[m + count] * g1)
                        + (F.basis[m + 2 * count] * g2 + F.basis[m + 3 * count] * g3)
                    )
            for i in range((count // 4) * 4, count):
                g = F.modal[b, src + o + first + i]
                for k_ in range(count):
                    k = F.index[k_]
                    F.modal[b, dst + o + first + k] = F.modal[b, dst + o + first + k] + F.basis[C + i * count + k] * g
        if inverse == 1:
            butterfly(b, nu, dst + o)


@ti.func
def spectral(b, nu, nv, c0, c1):
    """sp <- K0^-1 sp for components c0..c1 (u, v, normal)"""
    N = nu * nv
    for c in range(c0, c1):
        for k_ in range(nu):
            k = F.index[k_]
            F.modal[b, c * N + k] = F.modal[b, c * N + k] * (1.0 - F.lane[b, DTOP])
            F.modal[b, c * N + N - nu + k] = F.modal[b, c * N + N - nu + k] * (1.0 - F.lane[b, DBOT])
    transform(b, nu, nv, 0, 3 * N, 0, c0, c1)
    for c in range(c0, ti.min(c1, 2)):
        o = c * N
        for j in range(1, nv):
            for k_ in range(nu):
                k = F.index[k_]
                F.modal[b, 3 * N + o + j * nu + k] = (
                    F.modal[b, 3 * N + o + j * nu + k]
                    - F.factor[b, 2 * c * N + j * nu + k] * F.modal[b, 3 * N + o + j * nu - nu + k]
                )
        for k_ in range(nu):
            k = F.index[k_]
            F.modal[b, 3 * N + o + (nv - 1) * nu + k] = (
                F.modal[b, 3 * N + o + (nv - 1) * nu + k] * F.factor[b, 2 * c * N + N + (nv - 1) * nu + k]
            )
        for jj in range(1, nv):
            j = nv - 1 - jj
            for k_ in range(nu):
                k = F.index[k_]
                F.modal[b, 3 * N + o + j * nu + k] = (
                    F.modal[b, 3 * N + o + j * nu + k] * F.factor[b, 2 * c * N + N + j * nu + k]
                    - F.factor[b, 2 * c * N + j * nu + nu + k] * F.modal[b, 3 * N + o + j * nu + nu + k]
                )
    if c1 == 3:
        o = 2 * N
        for k_ in range(nu):
            k = F.index[k_]
            F.modal[b, 3 * N + o + nu + k] = (
                F.modal[b, 3 * N + o + nu + k] - F.factor[b, 4 * N + nu + k] * F.modal[b, 3 * N + o + k]
            )
        for j in range(2, nv):
            for k_ in range(nu):
                k = F.index[k_]
                F.modal[b, 3 * N + o + j * nu + k] = (
                    F.modal[b, 3 * N + o + j * nu + k]
                    - F.factor[b, 4 * N + j * nu + k] * F.modal[b, 3 * N + o + j * nu - nu + k]
                    - F.factor[b, 5 * N + j * nu + k] * F.modal[b, 3 * N + o + j * nu - 2 * nu + k]
                )
        for k_ in range(nu):
            k = F.index[k_]
            F.modal[b, 3 * N + o + (nv - 1) * nu + k] = (
                F.modal[b, 3 * N + o + (nv - 1) * nu + k] * F.factor[b, 6 * N + (nv - 1) * nu + k]
            )
        for k_ in range(nu):
            k = F.index[k_]
            F.modal[b, 3 * N + o + (nv - 2) * nu + k] = (
                F.modal[b, 3 * N + o + (nv - 2) * nu + k] * F.factor[b, 6 * N + (nv - 2) * nu + k]
                - F.factor[b, 4 * N + (nv - 1) * nu + k] * F.modal[b, 3 * N + o + (nv - 1) * nu + k]
            )
        for jj in range(2, nv):
            j = nv - 1 - jj
            for k_ in range(nu):
                k = F.index[k_]
                F.modal[b, 3 * N + o + j * nu + k] = (
                    F.modal[b, 3 * N + o + j * nu + k] * F.factor[b, 6 * N + j * nu + k]
                    - F.factor[b, 4 * N + j * nu + nu + k] * F.modal[b, 3 * N + o + j * nu + nu + k]
                    - F.factor[b, 5 * N + j * nu + 2 * nu + k] * F.modal[b, 3 * N + o + j * nu + 2 * nu + k]
                )
    transform(b, nu, nv, 3 * N, 0, 1, c0, c1)


@ti.func
def warp(b, nu, nv, src: ti.template()):
    s = nu + 2
    P = s * (nv + 2)
    N = nu * nv
    for j in range(nv):
        for i in range(nu):
            k = F.index[(j + 1) * s + i + 1]
            o = F.index[j * nu + i]
            m = F.node[b, F.free + k]
            x = F.node[b, src + k] * m
            y = F.node[b, src + P + k] * m
            z = F.node[b, src + 2 * P + k] * m
            ux = F.node[b, F.fu + k]
            uy = F.node[b, F.fu + P + k]
            uz = F.node[b, F.fu + 2 * P + k]
            nx = F.node[b, F.fn + k]
            ny = F.node[b, F.fn + P + k]
            nz = F.node[b, F.fn + 2 * P + k]
            F.modal[b, o] = ux * x + uy * y + uz * z
            F.modal[b, N + o] = (uy * nz - uz * ny) * x + (uz * nx - ux * nz) * y + (ux * ny - uy * nx) * z
            F.modal[b, 2 * N + o] = nx * x + ny * y + nz * z
            F.modal[b, 6 * N + o] = F.modal[b, o]
            F.modal[b, 7 * N + o] = F.modal[b, N + o]
            F.modal[b, 8 * N + o] = F.modal[b, 2 * N + o]


@ti.func
def unwarp(b, nu, nv, dst: ti.template()):
    """dst = world components of the warped field in F.modal"""
    s = nu + 2
    P = s * (nv + 2)
    N = nu * nv
    for j in range(nv):
        for i in range(nu):
            k = F.index[(j + 1) * s + i + 1]
            o = F.index[j * nu + i]
            m = F.node[b, F.free + k]
            a = F.modal[b, o] * m
            v = F.modal[b, N + o] * m
            n = F.modal[b, 2 * N + o] * m
            ux = F.node[b, F.fu + k]
            uy = F.node[b, F.fu + P + k]
            uz = F.node[b, F.fu + 2 * P + k]
            nx = F.node[b, F.fn + k]
            ny = F.node[b, F.fn + P + k]
            nz = F.node[b, F.fn + 2 * P + k]
            F.node[b, dst + k] = a * ux + v * (uy * nz - uz * ny) + n * nx
            F.node[b, dst + P + k] = a * uy + v * (uz * nx - ux * nz) + n * ny
            F.node[b, dst + 2 * P + k] = a * uz + v * (ux * ny - uy * nx) + n * nz


@ti.func
def frames(b, nu, nv, reach):
    s = nu + 2
    P = s * (nv + 2)
    for j in range(nv):
        for i in range(nu):
            k = F.index[(j + 1) * s + i + 1]
            w = k - ti.min(reach, i)
            e = k + ti.min(reach, nu - 1 - i)
            n = k - s * ti.min(reach, j)
            d = k + s * ti.min(reach, nv - 1 - j)
            ax = F.node[b, F.q + e] - F.node[b, F.q + w]
            ay = F.node[b, F.q + P + e] - F.node[b, F.q + P + w]
            az = F.node[b, F.q + 2 * P + e] - F.node[b, F.q + 2 * P + w]
            bx = F.node[b, F.q + d] - F.node[b, F.q + n]
            by = F.node[b, F.q + P + d] - F.node[b, F.q + P + n]
            bz = F.node[b, F.q + 2 * P + d] - F.node[b, F.q + 2 * P + n]
            cx = by * az - bz * ay
            cy = bz * ax - bx * az
            cz = bx * ay - by * ax
            il = 1.0 / ti.sqrt(cx * cx + cy * cy + cz * cz)
            F.node[b, F.fn + k] = cx * il
            F.node[b, F.fn + P + k] = cy * il
            F.node[b, F.fn + 2 * P + k] = cz * il
            ia = 1.0 / ti.sqrt(ax * ax + ay * ay + az * az)
            F.node[b, F.fu + k] = ax * ia
            F.node[b, F.fu + P + k] = ay * ia
            F.node[b, F.fu + 2 * P + k] = az * ia


@ti.func
def functionals(b, nu, nv, pt, src, c0):
    """t[16..22] = u, v, w, (w su), (w sv), w_u, w_v at fixed point pt of the warped field at sp[src]"""
    N = nu * nv
    for r_ in range(4):
        r = F.index[r_]
        for m in range(4):
            for lane in range(LANES):
                k = F.start[b, pt][lane] + r * nu + m
                for c in range(c0, 3):
                    F.patch[b, (r * 4 + m) * 3 + c][lane] = F.modal[b, src + c * N + k][lane]
    for c in range(c0, 3):
        for r_ in range(4):
            r = F.index[r_]
            x0 = F.patch[b, r * 12 + c]
            x1 = F.patch[b, r * 12 + 3 + c]
            x2 = F.patch[b, r * 12 + 6 + c]
            x3 = F.patch[b, r * 12 + 9 + c]
            for f in range(3):
                o = X.wu
                if f == 1:
                    o = X.eu_w
                if f == 2:
                    o = X.du
                o += 4 * pt
                F.row[b, f * 4 + r] = (
                    F.point[b, o] * x0 + F.point[b, o + 1] * x1 + F.point[b, o + 2] * x2 + F.point[b, o + 3] * x3
                )
        F.row[b, 16 + c] = (
            F.point[b, X.wv + 4 * pt] * F.row[b, 0]
            + F.point[b, X.wv + 4 * pt + 1] * F.row[b, 1]
            + F.point[b, X.wv + 4 * pt + 2] * F.row[b, 2]
            + F.point[b, X.wv + 4 * pt + 3] * F.row[b, 3]
        )
    F.row[b, 19] = (
        F.point[b, X.wv + 4 * pt] * F.row[b, 4]
        + F.point[b, X.wv + 4 * pt + 1] * F.row[b, 5]
        + F.point[b, X.wv + 4 * pt + 2] * F.row[b, 6]
        + F.point[b, X.wv + 4 * pt + 3] * F.row[b, 7]
    )
    F.row[b, 20] = (
        F.point[b, X.ev_w + 4 * pt] * F.row[b, 0]
        + F.point[b, X.ev_w + 4 * pt + 1] * F.row[b, 1]
        + F.point[b, X.ev_w + 4 * pt + 2] * F.row[b, 2]
        + F.point[b, X.ev_w + 4 * pt + 3] * F.row[b, 3]
    )
    F.row[b, 21] = (
        F.point[b, X.wv + 4 * pt] * F.row[b, 8]
        + F.point[b, X.wv + 4 * pt + 1] * F.row[b, 9]
        + F.point[b, X.wv + 4 * pt + 2] * F.row[b, 10]
        + F.point[b, X.wv + 4 * pt + 3] * F.row[b, 11]
    )
    F.row[b, 22] = (
        F.point[b, X.dv + 4 * pt] * F.row[b, 0]
        + F.point[b, X.dv + 4 * pt + 1] * F.row[b, 1]
        + F.point[b, X.dv + 4 * pt + 2] * F.row[b, 2]
        + F.point[b, X.dv + 4 * pt + 3] * F.row[b, 3]
    )


@ti.func
def weight(b, pt, f, r, m):
    a = X.wu
    c = X.wv
    if f == 1:
        a = X.eu_w
    if f == 2:
        c = X.ev_w
    if f == 3:
        a = X.du
    if f == 4:
        c = X.dv
    return F.point[b, a + 4 * pt + m] * F.point[b, c + 4 * pt + r]


@ti.func
def green(b, nu, nv, npt):
    """G[a,b] = response of the functionals of point a to those of point b: 0 uu, 1 vv, 2.. 5x5 normal"""
    N = nu * nv
    for pb_ in range(npt):
        pb = F.index[pb_]
        for f in range(5):
            c0 = 0
            if f > 0:
                c0 = 2
            for k_ in range(c0 * N, 3 * N):
                k = F.index[k_]
                F.modal[b, k] = Lanes(0.0)
            for r_ in range(4):
                r = F.index[r_]
                for m in range(4):
                    p = weight(b, pb, f, r, m)
                    for lane in range(LANES):
                        k = F.start[b, pb][lane] + r * nu + m
                        for c in range(c0, 3):
                            F.modal[b, c * N + k][lane] = p[lane]
            spectral(b, nu, nv, c0, 3)
            for pa_ in range(npt):
                pa = F.index[pa_]
                o = (pa * F.points + pb) * GREEN
                functionals(b, nu, nv, pa, 0, c0)
                if c0 == 0:
                    F.green[b, o] = F.row[b, 16]
                    F.green[b, o + 1] = F.row[b, 17]
                for g in range(5):
                    F.green[b, o + 2 + g * 5 + f] = F.row[b, 18 + g]


@ti.func
def woodbury(b, nu, nv, npt):
    """S = 1/km + J K0^-1 J^T in the current frames, and its LDL^T"""
    ns = npt - 1
    for pt_ in range(npt):
        pt = F.index[pt_]
        gather(b, nu, nv, pt, F.fu)
        interp(b, pt, X.grad_u, X.tmp, X.force)
        gather(b, nu, nv, pt, F.fn)
        interp(b, pt, X.grad_v, X.tmp, X.force)
    for k_ in range(ns):
        k = F.index[k_]
        dx = F.point[b, X.dir + k]
        dy = F.point[b, X.dir + F.points + k]
        dz = F.point[b, X.dir + 2 * F.points + k]
        for e in range(2):
            p = k + e
            sg = F.point[b, X.active + k] * (2.0 * e - 1.0)
            ax = F.point[b, X.grad_u + p]
            ay = F.point[b, X.grad_u + F.points + p]
            az = F.point[b, X.grad_u + 2 * F.points + p]
            nx = F.point[b, X.grad_v + p]
            ny = F.point[b, X.grad_v + F.points + p]
            nz = F.point[b, X.grad_v + 2 * F.points + p]
            du = (dx * ax + dy * ay + dz * az) * sg
            dv = ((ay * nz - az * ny) * dx + (az * nx - ax * nz) * dy + (ax * ny - ay * nx) * dz) * sg
            o = X.coef + e * 7 * F.points + k
            F.point[b, o] = du
            F.point[b, o + F.points] = dv
            F.point[b, o + 2 * F.points] = (dx * nx + dy * ny + dz * nz) * sg
            F.point[b, o + 3 * F.points] = (
                dx * F.point[b, X.tmp + p]
                + dy * F.point[b, X.tmp + F.points + p]
                + dz * F.point[b, X.tmp + 2 * F.points + p]
            ) * sg
            F.point[b, o + 4 * F.points] = (
                dx * F.point[b, X.force + p]
                + dy * F.point[b, X.force + F.points + p]
                + dz * F.point[b, X.force + 2 * F.points + p]
            ) * sg
            F.point[b, o + 5 * F.points] = -F.point[b, X.offset + p] * du
            F.point[b, o + 6 * F.points] = -F.point[b, X.offset + p] * dv
    for s_ in range(ns):
        s = F.index[s_]
        for a in range(s, npt):  # h_a = sum over both ends of s of G[a,b] c_b
            for i_ in range(7):
                i = F.index[i_]
                F.point[b, X.resp + i * F.points + a] = Lanes(0.0)
            for e in range(2):
                o = (a * F.points + s + e) * GREEN
                q = X.coef + e * 7 * F.points + s
                F.point[b, X.resp + a] = F.point[b, X.resp + a] + F.green[b, o] * F.point[b, q]
                F.point[b, X.resp + F.points + a] = (
                    F.point[b, X.resp + F.points + a] + F.green[b, o + 1] * F.point[b, q + F.points]
                )
                c2 = F.point[b, q + 2 * F.points]
                c3 = F.point[b, q + 3 * F.points]
                c4 = F.point[b, q + 4 * F.points]
                c5 = F.point[b, q + 5 * F.points]
                c6 = F.point[b, q + 6 * F.points]
                for g in range(5):
                    h = X.resp + (2 + g) * F.points + a
                    og = o + 2 + 5 * g
                    F.point[b, h] = (
                        F.point[b, h]
                        + (F.green[b, og] * c2 + F.green[b, og + 1] * c3 + F.green[b, og + 2] * c4)
                        + (F.green[b, og + 3] * c5 + F.green[b, og + 4] * c6)
                    )
        for r_ in range(s, ns):
            r = F.index[r_]
            x = F.point[b, X.coef + r] * F.point[b, X.resp + r]
            for e in ti.static(range(2)):
                for i in ti.static(range(7)):
                    if ti.static(e + i > 0):
                        x = (
                            x
                            + F.point[b, X.coef + (e * 7 + i) * F.points + r]
                            * F.point[b, X.resp + i * F.points + r + e]
                        )
            F.dual[b, r * F.points + s] = x
        F.dual[b, s * F.points + s] = F.dual[b, s * F.points + s] * 1.00001 + F.point[b, X.compliance + s]
    for k_ in range(ns):
        k = F.index[k_]
        F.dual[b, k * F.points + k] = 1.0 / F.dual[b, k * F.points + k]
        for i_ in range(k + 1, ns):
            i = F.index[i_]
            ratio = F.dual[b, i * F.points + k] * F.dual[b, k * F.points + k]
            for j in range(k + 1, i + 1):
                F.dual[b, i * F.points + j] = F.dual[b, i * F.points + j] - ratio * F.dual[b, j * F.points + k]
        # column k below the diagonal keeps LANES*D; divide on use


@ti.func
def wood_solve(b, npt):
    """LAM <- S^-1 LAM (S[k,k] holds 1/d, S[i,k] holds l d)"""
    ns = npt - 1
    for k_ in range(ns):
        k = F.index[k_]
        t = F.point[b, X.lam + k] * F.dual[b, k * F.points + k]
        for i_ in range(k + 1, ns):
            i = F.index[i_]
            F.point[b, X.lam + i] = F.point[b, X.lam + i] - F.dual[b, i * F.points + k] * t
    for kk in range(ns):
        k = ns - 1 - kk
        F.point[b, X.lam + k] = F.point[b, X.lam + k] * F.dual[b, k * F.points + k]
        t = F.point[b, X.lam + k]
        for i_ in range(k):
            i = F.index[i_]
            F.point[b, X.lam + i] = F.point[b, X.lam + i] - F.dual[b, k * F.points + i] * t


@ti.func
def muscle_correct(b, nu, nv, npt):
    """sp[0] <- sp[R] - Jhat^T S^-1 Jhat sp[0]; R = 6N buffer"""
    N = nu * nv
    for k_ in range(npt):
        k = F.index[k_]
        F.point[b, X.lam + k] = Lanes(0.0)
    for p_ in range(npt):
        p = F.index[p_]
        functionals(b, nu, nv, p, 0, 0)
        for i_ in range(7):
            i = F.index[i_]
            if p < npt - 1:
                F.point[b, X.lam + p] = F.point[b, X.lam + p] + F.point[b, X.coef + i * F.points + p] * F.row[b, 16 + i]
            if p > 0:
                F.point[b, X.lam + p - 1] = (
                    F.point[b, X.lam + p - 1] + F.point[b, X.coef + (7 + i) * F.points + p - 1] * F.row[b, 16 + i]
                )
    wood_solve(b, npt)
    for p_ in range(npt):
        p = F.index[p_]
        for i_ in range(7):
            i = F.index[i_]
            F.row[b, 16 + i] = Lanes(0.0)
            if p < npt - 1:
                F.row[b, 16 + i] = F.row[b, 16 + i] - F.point[b, X.coef + i * F.points + p] * F.point[b, X.lam + p]
            if p > 0:
                F.row[b, 16 + i] = (
                    F.row[b, 16 + i] - F.point[b, X.coef + (7 + i) * F.points + p - 1] * F.point[b, X.lam + p - 1]
                )
        for r_ in range(4):
            r = F.index[r_]
            for m in range(4):
                o = (r * 4 + m) * 3
                w = F.point[b, X.wv + 4 * p + r] * F.point[b, X.wu + 4 * p + m]
                F.patch[b, o] = w * F.row[b, 16]
                F.patch[b, o + 1] = w * F.row[b, 17]
                F.patch[b, o + 2] = w * F.row[b, 18]
                for f in range(1, 5):
                    F.patch[b, o + 2] = F.patch[b, o + 2] + weight(b, p, f, r, m) * F.row[b, 18 + f]
                for c in range(3):
                    for lane in range(LANES):
                        k = 6 * N + c * N + F.start[b, p][lane] + r * nu + m
                        F.modal[b, k][lane] = F.modal[b, k][lane] + F.patch[b, (r * 4 + m) * 3 + c][lane]
    for k_ in range(3 * N):
        k = F.index[k_]
        F.modal[b, k] = F.modal[b, 6 * N + k]
