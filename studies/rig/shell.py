"""The cloth: a Kirchhoff-Love shell on a spline patch, its forces and its stiffness.

Kiendl, Bletzinger, Linhard, Wuechner 2009, "Isogeometric shell analysis with Kirchhoff-Love elements", with the
membrane in engineering strain: e1 = |a1| - 1, e2 = |a2| - 1, e3 the shear angle, and k = x,ab . n for the curvatures.
Stress follows docs/files.md: orthotropic with Poisson, bending B / (1 - nu12 nu21), Kelvin-Voigt viscosity.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fabdesign.nouns.array import Array

Ints = NDArray[np.int64]
DERIVATIVES = ((1, 0), (0, 1), (2, 0), (0, 2), (1, 1))  # of a basis function, in the kernels' order
# the quadrature points of a cloth, as the kernels take them: control points (points, m) that count there, the
# DERIVATIVES (points, 5, m) of their functions, weight [m^2], stiffness (points, 8), rest strain (points, 6), viscosity
# [N s/m], the share of the stress that relaxes, and the strain (points, 6) that has. A plain tuple: numba's cache could
# not be read once a class of its own was renamed
Cloth = tuple[Ints, Array, Array, Array, Array, Array, float, Array]


@njit(cache=True, fastmath=True)
def _kinematics(x: Array, nodes: Ints, basis: Array, a: Array) -> None:
    """Fills a (5, 3): a1, a2, x,uu, x,vv, x,uv."""
    for k in range(5):
        a[k, 0] = a[k, 1] = a[k, 2] = 0.0
    for i in range(nodes.shape[0]):
        for c in range(3):
            xi = x[nodes[i], c]
            for k in range(5):
                a[k, c] += basis[k, i] * xi


@njit(cache=True, fastmath=True)
def _strain(a: Array, e: Array, g: Array) -> tuple[Array, float, float]:
    """Return strains e (6,) and their gradients g (6, 5, 3) with respect to the five derivatives of the surface."""
    l1 = math.sqrt(a[0, 0] ** 2 + a[0, 1] ** 2 + a[0, 2] ** 2)
    l2 = math.sqrt(a[1, 0] ** 2 + a[1, 1] ** 2 + a[1, 2] ** 2)
    t1, t2 = a[0] / l1, a[1] / l2
    s = t1[0] * t2[0] + t1[1] * t2[1] + t1[2] * t2[2]
    g[:] = 0.0
    e[0], e[1], e[2] = l1 - 1.0, l2 - 1.0, math.asin(s)
    c = math.sqrt(1.0 - s * s)
    n = np.empty(3)  # towards the front: a2 x a1, for v runs down
    n[0] = a[1, 1] * a[0, 2] - a[1, 2] * a[0, 1]
    n[1] = a[1, 2] * a[0, 0] - a[1, 0] * a[0, 2]
    n[2] = a[1, 0] * a[0, 1] - a[1, 1] * a[0, 0]
    j = math.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    n /= j
    m12 = s * l1 * l2
    d1, d2 = np.empty(3), np.empty(3)  # dual vectors
    for i in range(3):
        g[0, 0, i] = t1[i]
        g[1, 1, i] = t2[i]
        g[2, 0, i] = (t2[i] - s * t1[i]) / (l1 * c)
        g[2, 1, i] = (t1[i] - s * t2[i]) / (l2 * c)
        d1[i] = (l2 * l2 * a[0, i] - m12 * a[1, i]) / (j * j)
        d2[i] = (l1 * l1 * a[1, i] - m12 * a[0, i]) / (j * j)
    for k in range(3):
        b = a[2 + k]
        e[3 + k] = b[0] * n[0] + b[1] * n[1] + b[2] * n[2]
        bd1 = b[0] * d1[0] + b[1] * d1[1] + b[2] * d1[2]
        bd2 = b[0] * d2[0] + b[1] * d2[1] + b[2] * d2[2]
        for i in range(3):
            g[3 + k, 0, i] = -bd1 * n[i]
            g[3 + k, 1, i] = -bd2 * n[i]
            g[3 + k, 2 + k, i] = n[i]
    return n, l1, l2


@njit(cache=True, fastmath=True)
def _stress(
    c: Array, e: Array, e_rest: Array, rate: Array, eta: Array, prony: float, memory: Array, out: Array
) -> None:
    """out (6,): N1, N2, S, M11, M22, 2 M12. c: membrane 11, 12, 22, shear; bending 11, 12, 22, twist."""
    d0 = e[0] - e_rest[0] - prony * memory[0]
    d1 = e[1] - e_rest[1] - prony * memory[1]
    d2 = e[2] - e_rest[2] - prony * memory[2]
    d3 = e[3] - e_rest[3] - prony * memory[3]
    d4 = e[4] - e_rest[4] - prony * memory[4]
    d5 = e[5] - e_rest[5] - prony * memory[5]
    out[0] = c[0] * d0 + c[1] * d1 + eta * rate[0]
    out[1] = c[1] * d0 + c[2] * d1 + eta * rate[1]
    out[2] = c[3] * d2 + 0.5 * eta * rate[2]
    out[3] = c[4] * d3 + c[5] * d4
    out[4] = c[5] * d3 + c[6] * d4
    out[5] = 2.0 * c[7] * d5


@njit(cache=True, fastmath=True)
def forces(x: Array, cloth: Cloth, rate_gain: float, rate_history: Array, strain: Array, out: Array) -> None:
    """Adds the internal force [N] of the cloth to out (n, 3) and stores the strains (points, 6).

    The strain rate is rate_gain * strain + rate_history (points, 3): the time scheme's difference formula.
    """
    nodes, basis, weight, c, e_rest, eta, prony, memory = cloth
    a, e, g = np.empty((5, 3)), np.empty(6), np.empty((6, 5, 3))
    stress, rate, f = np.empty(6), np.empty(3), np.empty((5, 3))
    for q in range(basis.shape[0]):
        _kinematics(x, nodes[q], basis[q], a)
        _strain(a, e, g)
        strain[q] = e
        for k in range(3):
            rate[k] = rate_gain * e[k] + rate_history[q, k]
        _stress(c[q], e, e_rest[q], rate, eta[q], prony, memory[q], stress)
        for k in range(5):
            for i in range(3):
                f[k, i] = 0.0
                for r in range(6):
                    f[k, i] += stress[r] * g[r, k, i]
                f[k, i] *= weight[q]
        for i in range(nodes.shape[1]):
            for d in range(3):
                out[nodes[q, i], d] += (
                    basis[q, 0, i] * f[0, d]
                    + basis[q, 1, i] * f[1, d]
                    + basis[q, 2, i] * f[2, d]
                    + basis[q, 3, i] * f[3, d]
                    + basis[q, 4, i] * f[4, d]
                )


@njit(cache=True, fastmath=True)
def _hessian(
    a: Array, g: Array, n: Array, l1: float, l2: float, c: Array, stress: Array, visc: float, exact: bool, h: Array
) -> None:
    """h (15, 15): second derivatives of the strain energy density with respect to a1, a2, x,uu, x,vv, x,uv.

    `exact` keeps the stress terms that may be negative (compression, second derivatives of the curvatures).
    """
    gf = g.reshape(6, 15)
    t1, t2 = a[0] / l1, a[1] / l2
    for i in range(15):
        m0 = (c[0] + visc) * gf[0, i] + c[1] * gf[1, i]
        m1 = c[1] * gf[0, i] + (c[2] + visc) * gf[1, i]
        m2 = (c[3] + 0.5 * visc) * gf[2, i]
        b0 = c[4] * gf[3, i] + c[5] * gf[4, i]
        b1 = c[5] * gf[3, i] + c[6] * gf[4, i]
        b2 = 2.0 * c[7] * gf[5, i]
        for k in range(15):
            h[i, k] = m0 * gf[0, k] + m1 * gf[1, k] + m2 * gf[2, k] + b0 * gf[3, k] + b1 * gf[4, k] + b2 * gf[5, k]
    n1, n2 = stress[0] / l1, stress[1] / l2
    if not exact:
        n1, n2 = max(n1, 0.0), max(n2, 0.0)
    for i in range(3):
        for k in range(3):
            unit = 1.0 if i == k else 0.0
            h[i, k] += n1 * (unit - t1[i] * t1[k])
            h[3 + i, 3 + k] += n2 * (unit - t2[i] * t2[k])
    if not exact:
        return
    m12 = a[0, 0] * a[1, 0] + a[0, 1] * a[1, 1] + a[0, 2] * a[1, 2]
    jj = l1 * l1 * l2 * l2 - m12 * m12
    dual = np.empty((2, 3))
    dual[0] = (l2 * l2 * a[0] - m12 * a[1]) / jj
    dual[1] = (l1 * l1 * a[1] - m12 * a[0]) / jj
    moment, bending = np.zeros(2), 0.0
    for k in range(3):
        for i in range(3):
            moment[0] += stress[3 + k] * a[2 + k, i] * dual[0, i]
            moment[1] += stress[3 + k] * a[2 + k, i] * dual[1, i]
            bending += stress[3 + k] * a[2 + k, i] * n[i]
    for p in range(2):
        for q in range(2):
            metric = dual[p, 0] * dual[q, 0] + dual[p, 1] * dual[q, 1] + dual[p, 2] * dual[q, 2]
            for i in range(3):
                for k in range(3):
                    h[3 * p + i, 3 * q + k] += (
                        moment[q] * n[i] * dual[p, k] + moment[p] * dual[q, i] * n[k] - metric * bending * n[i] * n[k]
                    )
        for m in range(3):
            for i in range(3):
                for k in range(3):
                    v = -stress[3 + m] * n[i] * dual[p, k]
                    h[3 * p + i, 6 + 3 * m + k] += v
                    h[6 + 3 * m + k, 3 * p + i] += v


@njit(cache=True, fastmath=True)
def stiffness(
    x: Array, cloth: Cloth, rate_gain: float, rate_history: Array, points_per_element: int, exact: bool, band: Array
) -> None:
    """Adds the cloth's stiffness to `band` (lower banded, 3 degrees of freedom a control point)."""
    nodes, basis, weight, c, e_rest, eta, prony, memory = cloth
    nb = nodes.shape[1]
    a, e, g, stress, rate = np.empty((5, 3)), np.empty(6), np.empty((6, 5, 3)), np.empty(6), np.empty(3)
    h, product = np.empty((15, 15)), np.empty((3, 15))
    ke = np.zeros((3 * nb, 3 * nb))
    for q in range(basis.shape[0]):
        if q % points_per_element == 0:
            ke[:] = 0.0
        _kinematics(x, nodes[q], basis[q], a)
        n, l1, l2 = _strain(a, e, g)
        for k in range(3):
            rate[k] = rate_gain * e[k] + rate_history[q, k]
        _stress(c[q], e, e_rest[q], rate, eta[q], prony, memory[q], stress)
        _hessian(a, g, n, l1, l2, c[q], stress, eta[q] * rate_gain, exact, h)
        for i in range(nb):
            for d in range(3):
                for k in range(15):
                    s = 0.0
                    for alpha in range(5):
                        s += basis[q, alpha, i] * h[3 * alpha + d, k]
                    product[d, k] = weight[q] * s
            for k in range(i + 1):
                for d in range(3):
                    for b in range(3):
                        ke[3 * i + d, 3 * k + b] += (
                            product[d, b] * basis[q, 0, k]
                            + product[d, 3 + b] * basis[q, 1, k]
                            + product[d, 6 + b] * basis[q, 2, k]
                            + product[d, 9 + b] * basis[q, 3, k]
                            + product[d, 12 + b] * basis[q, 4, k]
                        )
        if q % points_per_element == points_per_element - 1:
            for i in range(3 * nb):
                gi = 3 * nodes[q, i // 3] + i % 3
                for k in range(i + 1):
                    gk = 3 * nodes[q, k // 3] + k % 3
                    hi, lo = max(gi, gk), min(gi, gk)
                    band[hi - lo, lo] += ke[i, k]
