"""The flat cloth's own linear problem, solved exactly: eigenvectors across, banded factors along v."""

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
)

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
        k = 0
        while k < nu:
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
            k = F.after[k]


@ti.func
def butterfly(b, nu, row):
    """Entries i and nu - 1 - i of a row of F.modal become their sum and difference, where the basis has odd vectors."""
    w = 0
    while w < F.odd[None]:
        i = row + w
        k = row + nu - 1 - w
        x = F.modal[b, i]
        y = F.modal[b, k]
        F.modal[b, i] = x + y
        F.modal[b, k] = x - y
        w = F.after[w]


@ti.func
def transform(b, nu, nv, src, dst, inverse, c0, c1):
    """Rows of F.modal[src] times the basis across (its transpose where inverse = 1) into F.modal[dst]; even and odd
    vectors apart. Spends src."""
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
            i = 0
            while i < count:
                k = dst + o + first + i
                F.modal[b, k] = Lanes(0.0)
                i = F.after[i]
            for i4 in range(count // 4):
                i = src + o + first + i4 * 4
                g0 = F.modal[b, i]
                g1 = F.modal[b, i + 1]
                g2 = F.modal[b, i + 2]
                g3 = F.modal[b, i + 3]
                k = 0
                while k < count:
                    m = C + i4 * 4 * count + k
                    F.modal[b, dst + o + first + k] = (
                        F.modal[b, dst + o + first + k]
                        + (F.basis[m] * g0 + F.basis[m + count] * g1)
                        + (F.basis[m + 2 * count] * g2 + F.basis[m + 3 * count] * g3)
                    )
                    k = F.after[k]
            for left in range((count // 4) * 4, count):
                g = F.modal[b, src + o + first + left]
                k = 0
                while k < count:
                    F.modal[b, dst + o + first + k] = F.modal[b, dst + o + first + k] + F.basis[C + left * count + k] * g
                    k = F.after[k]
        if inverse == 1:
            butterfly(b, nu, dst + o)


@ti.func
def spectral(b, nu, nv, c0, c1):
    """sp <- K0^-1 sp for components c0..c1 (u, v, normal)"""
    N = nu * nv
    for c in range(c0, c1):
        k = 0
        while k < nu:
            F.modal[b, c * N + k] = F.modal[b, c * N + k] * (1.0 - F.lane[b, DTOP])
            F.modal[b, c * N + N - nu + k] = F.modal[b, c * N + N - nu + k] * (1.0 - F.lane[b, DBOT])
            k = F.after[k]
    transform(b, nu, nv, 0, 3 * N, 0, c0, c1)
    for c in range(c0, ti.min(c1, 2)):
        o = c * N
        for j in range(1, nv):
            k = 0
            while k < nu:
                F.modal[b, 3 * N + o + j * nu + k] = (
                    F.modal[b, 3 * N + o + j * nu + k]
                    - F.factor[b, 2 * c * N + j * nu + k] * F.modal[b, 3 * N + o + j * nu - nu + k]
                )
                k = F.after[k]
        k = 0
        while k < nu:
            F.modal[b, 3 * N + o + (nv - 1) * nu + k] = (
                F.modal[b, 3 * N + o + (nv - 1) * nu + k] * F.factor[b, 2 * c * N + N + (nv - 1) * nu + k]
            )
            k = F.after[k]
        for jj in range(1, nv):
            j = nv - 1 - jj
            k = 0
            while k < nu:
                F.modal[b, 3 * N + o + j * nu + k] = (
                    F.modal[b, 3 * N + o + j * nu + k] * F.factor[b, 2 * c * N + N + j * nu + k]
                    - F.factor[b, 2 * c * N + j * nu + nu + k] * F.modal[b, 3 * N + o + j * nu + nu + k]
                )
                k = F.after[k]
    if c1 == 3:
        o = 2 * N
        k = 0
        while k < nu:
            F.modal[b, 3 * N + o + nu + k] = (
                F.modal[b, 3 * N + o + nu + k] - F.factor[b, 4 * N + nu + k] * F.modal[b, 3 * N + o + k]
            )
            k = F.after[k]
        for j in range(2, nv):
            k = 0
            while k < nu:
                F.modal[b, 3 * N + o + j * nu + k] = (
                    F.modal[b, 3 * N + o + j * nu + k]
                    - F.factor[b, 4 * N + j * nu + k] * F.modal[b, 3 * N + o + j * nu - nu + k]
                    - F.factor[b, 5 * N + j * nu + k] * F.modal[b, 3 * N + o + j * nu - 2 * nu + k]
                )
                k = F.after[k]
        k = 0
        while k < nu:
            F.modal[b, 3 * N + o + (nv - 1) * nu + k] = (
                F.modal[b, 3 * N + o + (nv - 1) * nu + k] * F.factor[b, 6 * N + (nv - 1) * nu + k]
            )
            k = F.after[k]
        k = 0
        while k < nu:
            F.modal[b, 3 * N + o + (nv - 2) * nu + k] = (
                F.modal[b, 3 * N + o + (nv - 2) * nu + k] * F.factor[b, 6 * N + (nv - 2) * nu + k]
                - F.factor[b, 4 * N + (nv - 1) * nu + k] * F.modal[b, 3 * N + o + (nv - 1) * nu + k]
            )
            k = F.after[k]
        for jj in range(2, nv):
            j = nv - 1 - jj
            k = 0
            while k < nu:
                F.modal[b, 3 * N + o + j * nu + k] = (
                    F.modal[b, 3 * N + o + j * nu + k] * F.factor[b, 6 * N + j * nu + k]
                    - F.factor[b, 4 * N + j * nu + nu + k] * F.modal[b, 3 * N + o + j * nu + nu + k]
                    - F.factor[b, 5 * N + j * nu + 2 * nu + k] * F.modal[b, 3 * N + o + j * nu + 2 * nu + k]
                )
                k = F.after[k]
    transform(b, nu, nv, 3 * N, 0, 1, c0, c1)
