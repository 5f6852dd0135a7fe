"""B-splines on a rectangle: the rig's displacement space, C1 (degree 2) or C2 (degree 3).

Hughes, Cottrell, Bazilevs 2005, "Isogeometric analysis: CAD, finite elements, NURBS, exact geometry and mesh
refinement". Control points are numbered with the slower index first: index = slow * n_fast + fast.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from fabdesign.nouns.array import Array

Ints = NDArray[np.int64]
GAUSS = 2  # points of an element in each direction: enough for C1 quadratics and C2 cubics


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
