"""Fixed points seen from the modes across: what a field does there, what forces there do, and Green's functions.

The cloth's own solve leaves a field as rows of modes across (the second plane of F.modal3). A fixed point's loop is a
product of weights of modes, F.across, and weights of rows, F.down, of the functionals below; tangential modes are
others than the normal component's. F.rows holds its first row and how many times four rows it spans, over all lanes.
"""

import taichi as ti

from sim.kernels.fields import F, indices
from sim.kernels.vectors import Lanes, Wide, parts, thrice
from sim.solver.flat_cloth import solve_modes
from sim.state import GREEN

MEAN, SLOPE, MOMENT, TANGENTIAL = range(4)  # normal means, derivatives, first moments; tangential means


@ti.func
def at(pt, functional):
    """Where the weights of a fixed point begin in F.across and F.down."""
    return (pt * 4 + functional) * F.modes


@ti.func
def contract_rows(b, nu, nv, pt):
    """Sums over rows, mode by mode: means to F.line3; slopes and moments of the normal component to F.line."""
    slope = SLOPE * F.modes
    moment = MOMENT * F.modes
    for k in indices(nu):
        F.line3[b, k] = Wide(0.0)
        F.line[b, slope + k] = Lanes(0.0)
        F.line[b, moment + k] = Lanes(0.0)
    for quad in range(F.rows[b, pt][1]):
        row = F.rows[b, pt][0] + 4 * quad
        w = at(pt, MEAN) + row
        s = at(pt, SLOPE) + row
        m = at(pt, MOMENT) + row
        for k in indices(nu):
            o = nu * nv + row * nu + k
            e0 = F.modal3[b, o]
            e1 = F.modal3[b, o + nu]
            e2 = F.modal3[b, o + 2 * nu]
            e3 = F.modal3[b, o + 3 * nu]
            _, _, n0 = parts(e0)
            _, _, n1 = parts(e1)
            _, _, n2 = parts(e2)
            _, _, n3 = parts(e3)
            F.line3[b, k] = F.line3[b, k] + (
                (thrice(F.down[b, w]) * e0 + thrice(F.down[b, w + 1]) * e1)
                + (thrice(F.down[b, w + 2]) * e2 + thrice(F.down[b, w + 3]) * e3)
            )
            F.line[b, slope + k] = F.line[b, slope + k] + (
                (F.down[b, s] * n0 + F.down[b, s + 1] * n1) + (F.down[b, s + 2] * n2 + F.down[b, s + 3] * n3)
            )
            F.line[b, moment + k] = F.line[b, moment + k] + (
                (F.down[b, m] * n0 + F.down[b, m + 1] * n1) + (F.down[b, m + 2] * n2 + F.down[b, m + 3] * n3)
            )


@ti.func
def functionals(b, nu, pt, scaled: ti.template(), other, functional):
    """F.row[0..6] = u, v, w, (w s_u), (w s_v), w_u, w_v at fixed point pt of the field whose sums over rows
    `contract_rows` left; if scaled, of the field with its modes multiplied by the weights of the point `other`."""
    for i in indices(7):
        F.row[b, i] = Lanes(0.0)
    for k in indices(nu):
        mean = F.across[b, at(pt, MEAN) + k]
        slope = F.across[b, at(pt, SLOPE) + k]
        moment = F.across[b, at(pt, MOMENT) + k]
        tangential = F.across[b, at(pt, TANGENTIAL) + k]
        if ti.static(scaled):
            scale = F.across[b, at(other, functional) + k]
            mean *= scale
            slope *= scale
            moment *= scale
            tangential *= F.across[b, at(other, TANGENTIAL) + k]
        line = F.line3[b, k]
        u, v, w = parts(line)
        F.row[b, 0] = F.row[b, 0] + tangential * u
        F.row[b, 1] = F.row[b, 1] + tangential * v
        F.row[b, 2] = F.row[b, 2] + mean * w
        F.row[b, 3] = F.row[b, 3] + moment * w
        F.row[b, 4] = F.row[b, 4] + mean * F.line[b, MOMENT * F.modes + k]
        F.row[b, 5] = F.row[b, 5] + slope * w
        F.row[b, 6] = F.row[b, 6] + mean * F.line[b, SLOPE * F.modes + k]


@ti.func
def add_sources(b, nu, nv, pt):
    """The transpose: what F.row[0..6] at the fixed point adds to the field."""
    for k in indices(nu):
        mean = F.across[b, at(pt, MEAN) + k]
        w = (
            F.row[b, 2] * mean
            + F.row[b, 3] * F.across[b, at(pt, MOMENT) + k]
            + F.row[b, 5] * F.across[b, at(pt, SLOPE) + k]
        )
        tangential = F.across[b, at(pt, TANGENTIAL) + k]
        F.line3[b, k] = Wide(F.row[b, 0] * tangential, F.row[b, 1] * tangential, w)
    first = F.rows[b, pt][0]
    for row in range(first, ti.min(first + 4 * F.rows[b, pt][1], nv)):
        share = F.down[b, at(pt, MEAN) + row]
        F.row[b, 7] = F.row[b, 4] * F.down[b, at(pt, MOMENT) + row] + F.row[b, 6] * F.down[b, at(pt, SLOPE) + row]
        for k in indices(nu):
            o = nu * nv + row * nu + k
            normal = Wide(Lanes(0.0), Lanes(0.0), F.row[b, 7] * F.across[b, at(pt, MEAN) + k])
            F.modal3[b, o] = F.modal3[b, o] + (thrice(share) * F.line3[b, k] + normal)


@ti.func
def green(b, nu, nv, npt):
    """G[a,b] = response of the functionals of point a to those of point b: 0 uu, 1 vv, 2.. 5x5 normal; symmetric."""
    for pb in indices(npt):
        for down in indices(3):
            for row in range(nv):
                for k in indices(nu):
                    F.modal3[b, nu * nv + row * nu + k] = thrice(F.down[b, at(pb, down) + row])
            solve_modes(b, nu, nv)
            for pa in indices(pb, npt):
                contract_rows(b, nu, nv, pa)
                for across in indices(3):
                    if across == MEAN or down == MEAN:
                        functionals(b, nu, pa, True, pb, across)
                        f = 0  # as in F.row, of the normal component
                        if across != MEAN:
                            f = 1 if across == MOMENT else 3
                        if down != MEAN:
                            f = 2 if down == MOMENT else 4
                        ab = (pa * F.points + pb) * GREEN
                        ba = (pb * F.points + pa) * GREEN
                        if f == 0:
                            for i in range(2):
                                F.green[b, ab + i] = F.row[b, i]
                                F.green[b, ba + i] = F.row[b, i]
                        for g in indices(5):
                            F.green[b, ab + 2 + g * 5 + f] = F.row[b, 2 + g]
                            F.green[b, ba + 2 + f * 5 + g] = F.row[b, 2 + g]
