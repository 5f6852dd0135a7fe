"""The cloth: a Kirchhoff-Love shell on a spline patch, its forces and its stiffness.

Kiendl, Bletzinger, Linhard, Wuechner 2009, "Isogeometric shell analysis with Kirchhoff-Love elements", with the
membrane in engineering strain: e1 = |a1| - 1, e2 = |a2| - 1, e3 the shear angle, and k = x,ab . n for the curvatures.
Stress follows docs/files.md: orthotropic with Poisson, bending B / (1 - nu12 nu21), Kelvin-Voigt viscosity.

The displacement space: B-splines on a rectangle, C1 (degree 2) or C2 (degree 3). Hughes, Cottrell, Bazilevs 2005,
"Isogeometric analysis: CAD, finite elements, NURBS, exact geometry and mesh refinement". Control points are numbered
with the slower index first: index = slow * n_fast + fast.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from fabdesign.nouns.array import Array

Ints = NDArray[np.int64]
GAUSS = 2  # points of an element in each direction: enough for C1 quadratics and C2 cubics
DERIVATIVES = ((1, 0), (0, 1), (2, 0), (0, 2), (1, 1))  # of the surface: a1, a2, x,uu, x,vv, x,uv
VISCOUS = np.array([1.0, 1.0, 0.5])  # of the viscosity, against the rates of e1, e2, e3


@dataclass(frozen=True, eq=False)
class Axis:
    """An open knot vector over [0, length] m."""

    breaks: Array  # (elements + 1,) m
    degree: int

    @property
    def count(self) -> int:
        """Return the number of basis functions."""
        return len(self.breaks) - 1 + self.degree

    @property
    def knots(self) -> Array:
        p = self.degree
        return np.r_[[self.breaks[0]] * p, self.breaks, [self.breaks[-1]] * p]

    def greville(self) -> Array:
        """Return (count,) m: control values that reproduce the identity."""
        k, p = self.knots, self.degree
        return np.array([k[i + 1 : i + p + 1].mean() for i in range(self.count)])

    def first(self, s: Array) -> Ints:
        """Return the index of the first of the degree + 1 functions that live at `s` [m]."""
        e = np.searchsorted(self.breaks, s, side="right") - 1
        return np.clip(e, 0, len(self.breaks) - 2).astype(np.int64)

    def basis(self, s: Array, derivative: int) -> Array:
        """Return (len(s), count) values of every basis function's derivative at `s` [m], dense."""
        s = np.clip(np.asarray(s, dtype=float), self.breaks[0], self.breaks[-1])
        eye = np.eye(self.count)
        spline = BSpline(self.knots, eye, self.degree)
        return np.asarray(spline(s, nu=derivative) if derivative else spline(s))


@dataclass(frozen=True, eq=False)
class Patch:
    """A tensor-product spline over the cloth; `u_slow` says which direction numbers the blocks of the matrix."""

    u: Axis
    v: Axis
    u_slow: bool

    @property
    def count(self) -> int:
        return self.u.count * self.v.count

    def index(self, iu: Ints, iv: Ints) -> Ints:
        return iu * self.v.count + iv if self.u_slow else iv * self.u.count + iu

    def flat(self) -> Array:
        """Return (count, 3) control points [m] of the cloth at rest in the plane z = 0."""
        gu, gv = np.meshgrid(np.arange(self.u.count), np.arange(self.v.count), indexing="ij")
        x = np.zeros((self.count, 3))
        k = self.index(gu, gv)
        x[k, 0] = self.u.greville()[gu] - self.u.breaks[-1] / 2
        x[k, 1] = -self.v.greville()[gv]
        return x

    def matrix(self, uv: Array, du: int = 0, dv: int = 0) -> sp.csr_matrix:
        """Return (len(uv), count) sparse matrix that takes control points to the derivative (du, dv) at `uv` [m]."""
        uv = np.asarray(uv, dtype=float)
        if not len(uv):
            return sp.csr_matrix((0, self.count))
        nodes, values = self.local(uv, ((du, dv),))
        rows = np.repeat(np.arange(len(uv)), nodes.shape[1])
        return sp.csr_matrix((values[:, 0].ravel(), (rows, nodes.ravel())), shape=(len(uv), self.count))

    def local(self, uv: Array, derivatives: tuple[tuple[int, int], ...]) -> tuple[Ints, Array]:
        """Return nodes (n, (p+1)^2) that live at `uv` (n, 2) m, and their derivatives (n, len(derivatives),
        (p+1)^2)."""
        p = self.u.degree
        a = np.arange(p + 1)
        iu = self.u.first(uv[:, 0])[:, None] + a
        iv = self.v.first(uv[:, 1])[:, None] + a
        nodes = self.index(iu[:, :, None], iv[:, None, :]).reshape(len(uv), -1)
        values = np.empty((len(uv), len(derivatives), (p + 1) ** 2))
        for k, (du, dv) in enumerate(derivatives):
            bu = np.take_along_axis(self.u.basis(uv[:, 0], du), iu, axis=1)
            bv = np.take_along_axis(self.v.basis(uv[:, 1], dv), iv, axis=1)
            values[:, k] = (bu[:, :, None] * bv[:, None, :]).reshape(len(uv), -1)
        return nodes, values

    def quadrature(self) -> tuple[Array, Array]:
        """Return Gauss points (n, 2) m and weights (n,) m^2, GAUSS a direction, element by element.

        Splines as smooth as these need no degree + 1 points (Schillinger, Hossain and Hughes 2014, "Reduced Bezier
        element quadrature rules for quadratic and cubic splines in isogeometric analysis").
        """
        g, w = np.polynomial.legendre.leggauss(GAUSS)
        points, weights = [], []
        for axis in (self.u, self.v):
            half = np.diff(axis.breaks) / 2
            points.append((axis.breaks[:-1] + half)[:, None] + half[:, None] * g)  # (elements, gauss)
            weights.append(half[:, None] * w)
        pu, pv = points
        uv = np.stack(
            np.broadcast_arrays(pu[:, None, :, None], pv[None, :, None, :]), axis=-1
        )  # element u, element v, gauss u, gauss v
        ww = weights[0][:, None, :, None] * weights[1][None, :, None, :]
        return uv.reshape(-1, 2), ww.reshape(-1)


class Strained(NamedTuple):
    """The cloth's strains at quadrature points, and what their derivatives need."""

    surface: Array  # (q, 5, 3) the DERIVATIVES
    strain: Array  # (q, 6)
    tangent: Array  # (q, 2, 3) of unit length
    shear: Array  # (q, 2, 3) derivatives of e3 by a1 and a2
    dual: Array  # (q, 2, 3) dual vectors
    normal: Array  # (q, 3) of unit length, towards the front


def strained(surface: Array) -> Strained:
    """Return the strains of a surface with such derivatives (q, 5, 3)."""
    a = surface[:, :2]
    length = np.linalg.norm(a, axis=2)
    tangent = a / length[..., None]
    s = np.einsum("qi,qi->q", tangent[:, 0], tangent[:, 1])
    normal = np.cross(a[:, 1], a[:, 0])  # towards the front: a2 x a1, for v runs down
    area = np.linalg.norm(normal, axis=1)
    normal /= area[:, None]
    m12 = s * length[:, 0] * length[:, 1]
    dual = (length[:, ::-1, None] ** 2 * a - m12[:, None, None] * a[:, ::-1]) / area[:, None, None] ** 2
    bent = np.einsum("qki,qi->qk", surface[:, 2:], normal)
    strain = np.concatenate([length - 1, np.arcsin(s)[:, None], bent], axis=1)
    shear = (tangent[:, ::-1] - s[:, None, None] * tangent) / (length * np.sqrt(1.0 - s**2)[:, None])[..., None]
    return Strained(surface, strain, tangent, shear, dual, normal)


def forces(at: Strained, stress: Array) -> Array:
    """Return (q, 5, 3): derivatives of the strain energy density by those of the surface. stress (q, 6)."""
    by_surface = np.empty(at.surface.shape)
    by_surface[:, :2] = stress[:, :2, None] * at.tangent + stress[:, 2, None, None] * at.shear
    by_surface[:, :2] -= _moment(at, stress)[..., None] * at.normal[:, None]
    by_surface[:, 2:] = stress[:, 3:, None] * at.normal[:, None]
    return by_surface


def _moment(at: Strained, stress: Array) -> Array:
    """Return (q, 2): what bends, along the dual vectors."""
    return np.asarray(at.dual @ (stress[:, None, 3:] @ at.surface[:, 2:]).transpose(0, 2, 1))[..., 0]


def _gradient(at: Strained) -> Array:
    """Return (q, 6, 15) of the strains by the five derivatives of the surface."""
    gradient = np.zeros((len(at.strain), 6, 5, 3))
    gradient[:, [0, 1], [0, 1]] = at.tangent
    gradient[:, 2, :2] = at.shear
    gradient[:, 3:, :2] = -(at.surface[:, 2:] @ at.dual.transpose(0, 2, 1))[..., None] * at.normal[:, None, None]
    gradient[:, [3, 4, 5], [2, 3, 4]] = at.normal[:, None]
    return gradient.reshape(-1, 6, 15)


def moduli(c: Array) -> Array:
    """Return (q, 6, 6): N1, N2, S, M11, M22, 2 M12 by strain. c (q, 8): membrane 11, 12, 22, shear; bending 11, 12, 22,
    twist."""
    by_strain = np.zeros((len(c), 6, 6))
    for k, row, column in ((0, 0, 0), (1, 0, 1), (2, 1, 1), (3, 2, 2), (4, 3, 3), (5, 3, 4), (6, 4, 4), (7, 5, 5)):
        by_strain[:, row, column] = by_strain[:, column, row] = c[:, k] * (1.0 if k < 7 else 2.0)
    return by_strain


def hessian(at: Strained, tangent: Array, stress: Array, exact: bool) -> Array:
    """Return (q, 5, 3, 5, 3): second derivatives of the strain energy density by the derivatives of the surface.

    tangent (q, 6, 6): of the stress (q, 6) by strain. `exact` keeps the stress terms that may be negative (compression,
    second derivatives of the curvatures).
    """
    g = _gradient(at)
    h = (g.transpose(0, 2, 1) @ (tangent @ g)).reshape(-1, 5, 3, 5, 3)
    for k in range(2):
        pull, length = stress[:, k], 1.0 + at.strain[:, k]
        across = np.eye(3) - at.tangent[:, k, :, None] * at.tangent[:, k, None]
        h[:, k, :, k] += ((pull if exact else np.maximum(pull, 0.0)) / length)[:, None, None] * across
    if not exact:
        return h
    n, dual, bent, moment = at.normal, at.dual, stress[:, 3:], _moment(at, stress)
    bending = np.einsum("qm,qm->q", bent, at.strain[:, 3:])
    turned = n[:, None, :, None, None] * moment[:, None, None, :, None] * dual[:, :, None, None]  # (q, p, i, r, k)
    metric = (dual @ dual.transpose(0, 2, 1) * bending[:, None, None])[:, :, None, :, None]
    normals = n[:, None, :, None, None] * n[:, None, None, None]
    h[:, :2, :, :2] += turned + turned.transpose(0, 3, 4, 1, 2) - metric * normals
    mixed = -bent[:, None, None, :, None] * n[:, None, :, None, None] * dual[:, :, None, None]
    h[:, :2, :, 2:] += mixed
    h[:, 2:, :, :2] += mixed.transpose(0, 3, 4, 1, 2)
    return h


def element_stiffness(basis: Array, hessians: Array) -> Array:
    """Return (elements, 3 m, 3 m) N/m, 3 degrees of freedom a control point. basis (elements, points, 5, m) and
    hessians (elements, points, 5, 3, 5, 3), times the points' weights."""
    count, points, _, m = basis.shape
    by_freedom = np.zeros((count, points, 5, 3, m, 3))
    by_freedom[:, :, :, range(3), :, range(3)] = basis
    surface = by_freedom.reshape(count, points, 15, 3 * m)
    pulls = hessians.reshape(count, points, 15, 15) @ surface
    return np.asarray(surface.reshape(count, -1, 3 * m).transpose(0, 2, 1) @ pulls.reshape(count, -1, 3 * m))


def add_to_band(nodes: Ints, blocks: Array, band: Array) -> None:
    """Add stiffnesses (k, 3 m, 3 m) between control points `nodes` (k, m) to a lower band (half + 1, 3 n), laid out by
    columns."""
    freedoms = (3 * nodes[..., None] + np.arange(3)).reshape(len(nodes), 3 * nodes.shape[1])
    below = freedoms[:, :, None] - freedoms[:, None]
    lower = below >= 0
    places = (below + freedoms[:, None] * len(band))[lower]
    np.add.at(band.reshape(-1, order="F"), places, blocks[lower])
