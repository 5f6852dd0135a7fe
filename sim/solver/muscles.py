"""The global solve: the cloth's own, with a low-rank (Woodbury) correction for the muscles."""

import taichi as ti

from sim.forces.muscles import sample
from sim.kernels.fields import F, X, indices
from sim.kernels.vectors import Lanes, crossed, dotted
from sim.solver.coarse_solve import prolong, restrict
from sim.solver.flat_cloth import solve_modes, transform
from sim.solver.muscle_modes import add_sources, contract_rows, functionals
from sim.state import GREEN


@ti.func
def woodbury(b, nu, npt):
    """S = 1/km + J K0^-1 J^T in the current frames, and its LDL^T"""
    ns = npt - 1
    sample(b, nu, npt, F.fu, F.fn, 2, X.fu)
    for k in indices(ns):
        along = F.point3[b, X.dir + k]
        for e in indices(2):
            p = k + e
            sg = F.point[b, X.active + k] * (2.0 * e - 1.0)
            du = dotted(along, F.point3[b, X.fu + p]) * sg
            dv = dotted(crossed(F.point3[b, X.fu + p], F.point3[b, X.fn + p]), along) * sg
            o = X.coef + e * 7 * F.points + k
            F.point[b, o] = du
            F.point[b, o + F.points] = dv
            F.point[b, o + 2 * F.points] = dotted(along, F.point3[b, X.fn + p]) * sg
            F.point[b, o + 3 * F.points] = dotted(along, F.point3[b, X.fn_u + p]) * sg
            F.point[b, o + 4 * F.points] = dotted(along, F.point3[b, X.fn_v + p]) * sg
            F.point[b, o + 5 * F.points] = -F.point[b, X.offset + p] * du
            F.point[b, o + 6 * F.points] = -F.point[b, X.offset + p] * dv
    for s in indices(ns):
        for a in range(s, npt):  # h_a = sum over both ends of s of G[a,b] c_b
            for i in indices(7):
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
        for r in indices(s, ns):
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
    for k in indices(ns):
        F.dual[b, k * F.points + k] = 1.0 / F.dual[b, k * F.points + k]
        for i in indices(k + 1, ns):
            ratio = F.dual[b, i * F.points + k] * F.dual[b, k * F.points + k]
            for j in range(k + 1, i + 1):
                F.dual[b, i * F.points + j] = F.dual[b, i * F.points + j] - ratio * F.dual[b, j * F.points + k]
        # column k below the diagonal keeps l d; divide on use


@ti.func
def wood_solve(b, npt):
    """LAM <- S^-1 LAM (S[k,k] holds 1/d, S[i,k] holds l d)"""
    ns = npt - 1
    for k in indices(ns):
        t = F.point[b, X.lam + k] * F.dual[b, k * F.points + k]
        for i in indices(k + 1, ns):
            F.point[b, X.lam + i] = F.point[b, X.lam + i] - F.dual[b, i * F.points + k] * t
    for kk in range(ns):
        k = ns - 1 - kk
        F.point[b, X.lam + k] = F.point[b, X.lam + k] * F.dual[b, k * F.points + k]
        t = F.point[b, X.lam + k]
        for i in indices(k):
            F.point[b, X.lam + i] = F.point[b, X.lam + i] - F.dual[b, k * F.points + i] * t


@ti.func
def muscle_correct(b, nu, nv, npt):
    """The second plane of F.modal3 <- R - J^T S^-1 J (the second plane), where R is its copy in the third."""
    N = nu * nv
    for k in indices(npt):
        F.point[b, X.lam + k] = Lanes(0.0)
    for p in indices(npt):
        contract_rows(b, nu, nv, p)
        functionals(b, nu, p, False, 0, 0)
        for i in indices(7):
            if p < npt - 1:
                F.point[b, X.lam + p] = F.point[b, X.lam + p] + F.point[b, X.coef + i * F.points + p] * F.row[b, i]
            if p > 0:
                F.point[b, X.lam + p - 1] = (
                    F.point[b, X.lam + p - 1] + F.point[b, X.coef + (7 + i) * F.points + p - 1] * F.row[b, i]
                )
    wood_solve(b, npt)
    for k in indices(N, 2 * N):
        F.modal3[b, k] = F.modal3[b, N + k]
    for p in indices(npt):
        for i in indices(7):
            F.row[b, i] = Lanes(0.0)
            if p < npt - 1:
                F.row[b, i] = F.row[b, i] - F.point[b, X.coef + i * F.points + p] * F.point[b, X.lam + p]
            if p > 0:
                F.row[b, i] = F.row[b, i] - F.point[b, X.coef + (7 + i) * F.points + p - 1] * F.point[b, X.lam + p - 1]
        add_sources(b, nu, nv, p)


@ti.func
def solve(b, nu, nv, npt, coarse):
    """The first plane of F.modal3 <- P^-1 (the first plane): the flat cloth's own solve, with muscles once more with
    what their tensions answer, and in the coarse space if wanted. Spends the second plane, with muscles the third."""
    N = nu * nv
    solves = 2 if npt > 0 else 1
    for inverse in range(2):
        transform(b, nu, nv, inverse * N, (1 - inverse) * N, inverse)
        if inverse == 0:
            for k in indices(N, N * solves):
                F.modal3[b, N + k] = F.modal3[b, k]
            if coarse:
                restrict(b, nu, nv)
            for turn in range(solves):
                if turn == 1:
                    muscle_correct(b, nu, nv, npt)
                solve_modes(b, nu, nv)
            if coarse:
                prolong(b, nu, nv)
