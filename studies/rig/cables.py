"""Muscles as cables: straight between fixed points that stand off the cloth along its normal; and their tension, by the
bench law, viscosity, and what muscle effects add.

A fixed point is a loop of finite size: its position and its normal are means over a square of `LOOP_SIZE`.
A force at a mathematical point would pull infinitely far into an elastic sheet (displacement ~ F / (2 pi k) ln r).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from studies.rig.spline import Patch

if TYPE_CHECKING:
    from studies.rig.scene import Scene

Ints = NDArray[np.int64]
LOOP_SIZE = 0.010  # m, about the width of the cloth's tape
LOOP_GAUSS = 3
CONTRACTIONS = np.linspace(-0.4, 0.6, 501)  # of the tabulated law; 0, the kink, is one of them
PRESSURE_STEP = 4e3  # Pa


@dataclass(frozen=True, eq=False)
class Cables:
    """Geometry of every muscle: points j and the intervals between them."""

    nodes: Ints  # (points, m) control points that a fixed point touches
    basis: Array  # (points, gauss, 3, m): value, d/du, d/dv, weighted to mean values
    offset: Array  # (points,) m along the front normal
    first: Ints  # (intervals,) index of an interval's upper point; the next one ends it
    rest: Array  # (intervals,) m
    muscle: Ints  # (intervals,) which muscle
    along: Array  # (intervals,) middle's distance from the muscle's first end over its length
    uv: Array  # (points, 2) m


def lace(design: Design, patch: Patch, offset_factor: float) -> Cables:
    """Return the fixed points of all muscles on the patch."""
    each = [muscle.fixed_points() for muscle in design.muscles]
    counts, types = [len(points) for points in each], [design.muscle_types[muscle.type] for muscle in design.muscles]
    uv = np.concatenate([np.zeros((0, 2)), *each])
    first = np.delete(np.arange(len(uv)), np.cumsum(counts, dtype=np.int64) - 1)
    rest = np.linalg.norm(uv[first + 1] - uv[first], axis=1)
    muscle = np.repeat(np.arange(len(each)), np.array(counts, dtype=np.int64) - 1)
    lengths = [rest[muscle == m] for m in range(len(each))]
    along = [(np.cumsum(length) - length / 2) / length.sum() for length in lengths]
    signs = [1 if each.side == "front" else -1 for each in design.muscles]
    offsets = [kind.axis_offset * offset_factor * sign for kind, sign in zip(types, signs, strict=True)]
    nodes, basis = _loops(uv, patch, design.fabric.width, design.fabric.height)
    offset = np.repeat(np.array(offsets, dtype=np.float64), counts)
    return Cables(nodes, basis, offset, first, rest, muscle, np.concatenate([np.zeros(0), *along]), uv)


def _loops(points: Array, patch: Patch, width: float, height: float) -> tuple[Ints, Array]:
    """Return control points and weighted basis of each loop, padded to the largest loop's node count."""
    g, w = np.polynomial.legendre.leggauss(LOOP_GAUSS)
    gu, gv = np.meshgrid(g, g, indexing="ij")
    weight = np.outer(w, w).ravel() / 4.0
    nodes_of, basis_of = [], []
    for u, v in points:
        half_u = min(LOOP_SIZE / 2, max(u, 1e-6), max(width - u, 1e-6))  # a loop at the hem is narrower
        half_v = min(LOOP_SIZE / 2, max(v, 1e-6), max(height - v, 1e-6))
        uv = np.stack([u + half_u * gu.ravel(), v + half_v * gv.ravel()], axis=1)
        local, values = patch.local(uv, ((0, 0), (1, 0), (0, 1)))
        nodes, place = np.unique(local, return_inverse=True)
        basis = np.zeros((len(uv), 3, len(nodes)))
        for q, row in enumerate(place.reshape(local.shape)):
            basis[q][:, row] += values[q] * weight[q]
        nodes_of.append(nodes)
        basis_of.append(basis)
    m = max((len(n) for n in nodes_of), default=0)
    nodes_out = np.zeros((len(points), m), np.int64)
    basis_out = np.zeros((len(points), LOOP_GAUSS**2, 3, m))
    for j, (n, b) in enumerate(zip(nodes_of, basis_of, strict=True)):
        nodes_out[j, : len(n)] = n
        nodes_out[j, len(n) :] = n[0]  # padding has zero weight
        basis_out[j, :, :, : len(n)] = b
    return nodes_out, basis_out


@njit(cache=True, fastmath=True)
def positions(x: Array, nodes: Ints, basis: Array, offset: Array, y: Array, jac: Array) -> None:
    """Fixed points y (points, 3) m and their Jacobians jac (points, m, 3, 3), dy_a / dx_b."""
    m = nodes.shape[1]
    a0, a1, a2, n, d1, d2 = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    weight = np.empty(basis.shape[1])
    for j in range(nodes.shape[0]):
        y[j] = 0.0
        jac[j] = 0.0
        for q in range(basis.shape[1]):
            a0[:] = 0.0
            a1[:] = 0.0
            a2[:] = 0.0
            weight[q] = 0.0
            for i in range(m):
                weight[q] += basis[j, q, 0, i]
                for c in range(3):
                    xi = x[nodes[j, i], c]
                    a0[c] += basis[j, q, 0, i] * xi
                    a1[c] += basis[j, q, 1, i] * xi
                    a2[c] += basis[j, q, 2, i] * xi
            n[0] = a2[1] * a1[2] - a2[2] * a1[1]
            n[1] = a2[2] * a1[0] - a2[0] * a1[2]
            n[2] = a2[0] * a1[1] - a2[1] * a1[0]
            jj = n[0] ** 2 + n[1] ** 2 + n[2] ** 2
            n /= np.sqrt(jj)
            m11 = a1[0] ** 2 + a1[1] ** 2 + a1[2] ** 2
            m22 = a2[0] ** 2 + a2[1] ** 2 + a2[2] ** 2
            m12 = a1[0] * a2[0] + a1[1] * a2[1] + a1[2] * a2[2]
            d = offset[j] * weight[q]
            for c in range(3):
                d1[c] = (m22 * a1[c] - m12 * a2[c]) / jj * d
                d2[c] = (m11 * a2[c] - m12 * a1[c]) / jj * d
                y[j, c] += a0[c] + d * n[c]
            for i in range(m):
                for c in range(3):
                    jac[j, i, c, c] += basis[j, q, 0, i]
                    t = d1[c] * basis[j, q, 1, i] + d2[c] * basis[j, q, 2, i]
                    for b in range(3):
                        jac[j, i, c, b] -= t * n[b]


@njit(cache=True, fastmath=True)
def forces(y: Array, jac: Array, nodes: Ints, first: Ints, tension: Array, out: Array) -> None:
    """Adds the cables' internal force (minus what they pull) to out (n, 3)."""
    for k in range(first.shape[0]):
        j = first[k]
        t = y[j + 1] - y[j]
        t *= tension[k] / np.sqrt(t[0] ** 2 + t[1] ** 2 + t[2] ** 2)
        for side in range(2):
            sign = -1.0 if side == 0 else 1.0
            for i in range(nodes.shape[1]):
                for b in range(3):
                    out[nodes[j + side, i], b] += sign * (
                        jac[j + side, i, 0, b] * t[0] + jac[j + side, i, 1, b] * t[1] + jac[j + side, i, 2, b] * t[2]
                    )


@njit(cache=True, fastmath=True)
def stiffness(
    y: Array, jac: Array, nodes: Ints, first: Ints, tension: Array, axial: Array, exact: bool, band: Array
) -> None:
    """Adds J^T (axial t t^T + T / l (1 - t t^T)) J of every interval; axial [N/m] is dT / dl.

    Without `exact`, compression (T < 0) is left out.
    """
    m = nodes.shape[1]
    dofs, rows = np.empty(6 * m, np.int64), np.empty((3, 6 * m))
    h = np.empty((3, 3))
    for k in range(first.shape[0]):
        j = first[k]
        t = y[j + 1] - y[j]
        length = np.sqrt(t[0] ** 2 + t[1] ** 2 + t[2] ** 2)
        t /= length
        geo = (tension[k] if exact else max(tension[k], 0.0)) / length
        for a in range(3):
            for b in range(3):
                h[a, b] = (axial[k] - geo) * t[a] * t[b] + (geo if a == b else 0.0)
        for side in range(2):
            sign = -1.0 if side == 0 else 1.0
            for i in range(m):
                for b in range(3):
                    p = 3 * (side * m + i) + b
                    dofs[p] = 3 * nodes[j + side, i] + b
                    for a in range(3):
                        rows[a, p] = sign * jac[j + side, i, a, b]
        hr = h @ rows
        for p in range(6 * m):
            for r in range(6 * m):
                if dofs[r] <= dofs[p]:
                    v = rows[0, p] * hr[0, r] + rows[1, p] * hr[1, r] + rows[2, p] * hr[2, r]
                    band[dofs[p] - dofs[r], dofs[r]] += v


_FIRST, _SPACING = float(CONTRACTIONS[0]), float(CONTRACTIONS[1] - CONTRACTIONS[0])


def pressure_at_intervals(scene: "Scene", pressure: Array) -> Array:
    """Return (intervals,) Pa that act in the muscles, from (channels,) Pa at the regulators."""
    state = scene.muscle_state
    p = pressure[scene.channel] * state.pressure_factor
    if state.threshold:
        w = state.threshold_width
        p = w * np.logaddexp(0.0, (p - state.threshold) / w) if w else np.maximum(p - state.threshold, 0.0)
    return np.asarray(p)


def tension(scene: "Scene", p: Array, contraction: Array, rate: Array, rate_gain: float) -> tuple[Array, Array]:
    """Return the tension (intervals,) N and its slope with contraction, at pressures p Pa and contraction rates 1/s."""
    state = scene.muscle_state
    law, law_slope = np.empty_like(p), np.empty_like(p)
    idle, idle_slope = np.empty_like(p), np.empty_like(p)
    seen = contraction - state.creep
    for m, table in enumerate(scene.tables):
        mine = scene.cables.muscle == m
        law[mine], law_slope[mine] = _interpolate(table, p[mine], seen[mine])
        idle[mine], idle_slope[mine] = _interpolate(table, np.zeros(mine.sum()), seen[mine])
    viscosity = np.where(rate > 0, state.viscosity, state.viscosity_out)
    force = idle + state.gain * (law - idle) - viscosity * rate
    slope = idle_slope + state.gain * (law_slope - idle_slope) - viscosity * rate_gain
    limit = state.friction_at_zero + state.friction_per_pressure * p
    if limit.any() and rate_gain:
        friction, stick = _friction(scene, limit, contraction)
        force = force - friction
        slope = slope - np.where(stick, limit / state.friction_slip, 0.0)
    return force, slope


def settle(scene: "Scene", p: Array, contraction: Array) -> None:
    """Keep the friction that a finished step ends with; there is none at rest, before the first step."""
    state = scene.muscle_state
    limit = state.friction_at_zero + state.friction_per_pressure * p
    if limit.any() and len(state.contraction_before):
        state.friction, _ = _friction(scene, limit, contraction)
    state.contraction_before = contraction


def _friction(scene: "Scene", limit: Array, contraction: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return one Maxwell-slip element: a spring that slips at the Coulomb limit; resists contraction."""
    state = scene.muscle_state
    trial = state.friction + limit / state.friction_slip * (contraction - state.contraction_before)
    return np.clip(trial, -limit, limit), np.abs(trial) < limit


@njit(cache=True)
def _interpolate(table: Array, p: Array, contraction: Array) -> tuple[Array, Array]:
    """Return bilinear, beyond the table in contraction linear, tension and its slope with contraction."""
    value, slope = np.empty(p.shape[0]), np.empty(p.shape[0])
    for i in range(p.shape[0]):
        a = min(max(p[i], 0.0) / PRESSURE_STEP, table.shape[0] - 1.000001)
        ia = int(a)
        b = (contraction[i] - _FIRST) / _SPACING
        ib = min(max(int(b), 0), table.shape[1] - 2)
        a -= ia
        lo = (1 - a) * table[ia, ib] + a * table[ia + 1, ib]
        hi = (1 - a) * table[ia, ib + 1] + a * table[ia + 1, ib + 1]
        value[i] = lo + (b - ib) * (hi - lo)
        slope[i] = (hi - lo) / _SPACING
    return value, slope
