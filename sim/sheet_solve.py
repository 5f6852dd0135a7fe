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
    vectors apart. Spends src. Three rows at a time, so that an entry of the basis is read once for them: with one
    component alone, up to two rows of what lies behind are spent too."""
    for triple in range(((c1 - c0) * nv + 2) // 3):
        x = src + (c0 * nv + 3 * triple) * nu
        y = dst + (c0 * nv + 3 * triple) * nu
        if inverse == 0:
            for row in range(3):
                butterfly(b, nu, x + row * nu)
        for part in range(2):
            count = nu - F.odd[None]
            C = inverse * (count * count + F.odd[None] * F.odd[None])
            first = 0
            if part == 1:
                C += count * count
                first = count
                count = F.odd[None]
            multiply_rows(b, nu, x + first, y + first, C, count)
        if inverse == 1:
            for row in range(3):
                butterfly(b, nu, y + row * nu)


@ti.func
def multiply_rows(b, nu, x, y, C, count):
    """Three rows of F.modal at y = those at x times the count x count matrix at C of F.basis."""
    k = 0
    while k < count:
        for row in ti.static(range(3)):
            F.modal[b, y + row * nu + k] = Lanes(0.0)
        k = F.after[k]
    for pair in range(count // 2):
        m = C + 2 * pair * count
        i = x + 2 * pair
        a0 = F.modal[b, i]
        a1 = F.modal[b, i + 1]
        b0 = F.modal[b, i + nu]
        b1 = F.modal[b, i + nu + 1]
        c0 = F.modal[b, i + 2 * nu]
        c1 = F.modal[b, i + 2 * nu + 1]
        k = 0
        while k < count:
            p = F.basis[m + k]
            q = F.basis[m + count + k]
            F.modal[b, y + k] = F.modal[b, y + k] + (p * a0 + q * a1)
            F.modal[b, y + nu + k] = F.modal[b, y + nu + k] + (p * b0 + q * b1)
            F.modal[b, y + 2 * nu + k] = F.modal[b, y + 2 * nu + k] + (p * c0 + q * c1)
            k = F.after[k]
    if count % 2 == 1:
        last = count - 1
        k = 0
        while k < count:
            p = F.basis[C + last * count + k]
            for row in ti.static(range(3)):
                F.modal[b, y + row * nu + k] = F.modal[b, y + row * nu + k] + p * F.modal[b, x + row * nu + last]
            k = F.after[k]


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
