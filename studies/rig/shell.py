"""The cloth: a Kirchhoff-Love shell on a spline patch, its forces and its stiffness.

Kiendl, Bletzinger, Linhard, Wuechner 2009, "Isogeometric shell analysis with Kirchhoff-Love elements", with the
membrane in engineering strain: e1 = |a1| - 1, e2 = |a2| - 1, e3 the shear angle, and k = x,ab . n for the curvatures.
Stress follows docs/files.md: orthotropic with Poisson, bending B / (1 - nu12 nu21), Kelvin-Voigt viscosity.
"""

from typing import NamedTuple

import numpy as np

from fabdesign.nouns.array import Array
from studies.rig.spline import Ints

DERIVATIVES = ((1, 0), (0, 1), (2, 0), (0, 2), (1, 1))  # of the surface: a1, a2, x,uu, x,vv, x,uv
VISCOUS = np.array([1.0, 1.0, 0.5])  # of the viscosity, against the rates of e1, e2, e3


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
