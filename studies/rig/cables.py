"""Muscles as cables: straight between fixed points that stand off the cloth along its normal; and their tension, by the
bench law, viscosity, and what muscle effects add.

A fixed point is a loop of finite size: its position and its normal are means over a square of `LOOP_SIZE`.
A force at a mathematical point would pull infinitely far into an elastic sheet (displacement ~ F / (2 pi k) ln r).
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from studies.rig.shell import Ints, Patch, add_to_band

if TYPE_CHECKING:
    from studies.rig.scene import Scene

LOOP_SIZE = 0.010  # m, about the width of the cloth's tape
LOOP_GAUSS = 3
CONTRACTIONS = np.linspace(-0.4, 0.6, 501)  # of the tabulated law; 0, the kink, is one of them
PRESSURE_STEP = 4e3  # Pa
TOGETHER = 50  # intervals whose stiffness is there at once


class Cables:
    """The fixed points of all muscles on a patch, and the intervals between them."""

    def __init__(self, design: Design, patch: Patch, offset_factor: float) -> None:
        each = [muscle.fixed_points() for muscle in design.muscles]
        counts = np.array([len(points) for points in each], dtype=np.int64)
        uv = np.concatenate([np.zeros((0, 2)), *each])
        # (intervals,) index of an interval's upper point; the next one ends it
        self.first = np.delete(np.arange(len(uv)), np.cumsum(counts) - 1)
        self.rest = np.linalg.norm(uv[self.first + 1] - uv[self.first], axis=1)  # (intervals,) m
        self.muscle = np.repeat(np.arange(len(each)), counts - 1)  # (intervals,) which muscle
        lengths = [self.rest[self.muscle == m] for m in range(len(each))]
        along = [(np.cumsum(length) - length / 2) / length.sum() for length in lengths]
        # (intervals,) middle's distance from the muscle's first end over its length
        self.along = np.concatenate([np.zeros(0), *along])
        kinds = [design.muscle_types[muscle.type] for muscle in design.muscles]
        signs = [1 if muscle.side == "front" else -1 for muscle in design.muscles]
        offsets = [kind.axis_offset * offset_factor * sign for kind, sign in zip(kinds, signs, strict=True)]
        self.offset = np.repeat(np.array(offsets, dtype=np.float64), counts)  # (points,) m along the front normal
        # (points, m) control points that a fixed point touches; (points, gauss, 3, m): value, d/du, d/dv, weighted to
        # mean values
        self.nodes, self.basis = _loops(uv, patch, design.fabric.width, design.fabric.height)
        ends = self.nodes[self.first], self.nodes[self.first + 1]
        self.touched = np.concatenate(ends, axis=1)  # (intervals, 2 m) control points that the ends touch


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
        every = np.stack([patch.matrix(uv, *d).toarray() for d in ((0, 0), (1, 0), (0, 1))], axis=1)
        nodes_of.append(np.flatnonzero(every.any(axis=(0, 1))))
        basis_of.append(every[:, :, nodes_of[-1]] * weight[:, None, None])
    m = max((len(nodes) for nodes in nodes_of), default=0)
    nodes = [np.pad(nodes, (0, m - len(nodes)), mode="edge") for nodes in nodes_of]  # padding has zero weight
    basis = [np.pad(each, ((0, 0), (0, 0), (0, m - each.shape[2]))) for each in basis_of]
    shape = len(points), LOOP_GAUSS**2, 3, m
    return np.array(nodes, dtype=np.int64).reshape(len(points), m), np.array(basis).reshape(shape)


class Spans(NamedTuple):
    """The intervals on a cloth: unit vectors down them (intervals, 3), lengths (intervals,) m, and the Jacobians
    (intervals, 3, 6 m) of the ways from end to end by the control points that `Cables.touched` says."""

    direction: Array
    length: Array
    jacobian: Array


def spans(cables: Cables, x: Array) -> Spans:
    """Return the intervals on a cloth with control points x (n, 3) m."""
    a = cables.basis @ x[cables.nodes][:, None]  # (points, gauss, 3, 3): places, and tangents
    along = a[:, :, 1:]
    normal = np.cross(a[:, :, 2], a[:, :, 1])
    area = np.linalg.norm(normal, axis=2)[..., None]
    normal /= area
    off = cables.offset[:, None, None] * cables.basis[:, :, 0].sum(axis=2)[..., None]
    place = (a[:, :, 0] + off * normal).sum(axis=1)
    metric = along @ along.swapaxes(2, 3)
    dual = np.stack([metric[..., 1, 1, None], metric[..., 0, 0, None]], axis=2) * along
    dual = (dual - metric[..., 0, 1, None, None] * along[:, :, ::-1]) * (off / area**2)[..., None]
    points, gauss, _, m = cables.basis.shape
    tilts = (dual[..., None] * normal[:, :, None, None]).reshape(points, 2 * gauss, 9)
    tilted = (cables.basis[:, :, 1:].reshape(points, 2 * gauss, m).swapaxes(1, 2) @ tilts).reshape(points, m, 3, 3)
    each = cables.basis[:, :, 0].sum(axis=1)[..., None, None] * np.eye(3) - tilted
    each = each.swapaxes(1, 2).reshape(points, 3, 3 * m)
    way = place[cables.first + 1] - place[cables.first]
    length = np.linalg.norm(way, axis=1)
    return Spans(way / length[:, None], length, np.concatenate([-each[cables.first], each[cables.first + 1]], axis=2))


def forces(cables: Cables, at: Spans, tension: Array, out: Array) -> None:
    """Add the cables' internal force (minus what they pull) to out (n, 3)."""
    pulls = np.einsum("ka,kar->kr", tension[:, None] * at.direction, at.jacobian)
    np.add.at(out, cables.touched, pulls.reshape(*cables.touched.shape, 3))


def stiffness(cables: Cables, at: Spans, tension: Array, axial: Array, exact: bool, band: Array) -> None:
    """Add J^T (axial t t^T + T / l (1 - t t^T)) J of every interval; axial [N/m] is dT / dl.

    Without `exact`, compression (T < 0) is left out.
    """
    geometric = (tension if exact else np.maximum(tension, 0.0)) / at.length
    h = (axial - geometric)[:, None, None] * at.direction[:, :, None] * at.direction[:, None]
    h += geometric[:, None, None] * np.eye(3)
    for some in np.array_split(np.arange(len(h)), 1 + len(h) // TOGETHER):
        rows = at.jacobian[some]
        add_to_band(cables.touched[some], rows.swapaxes(1, 2) @ (h[some] @ rows), band)


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
    law, law_slope = _by_law(scene, p, contraction - state.creep)
    idle, idle_slope = _by_law(scene, np.zeros_like(p), contraction - state.creep)
    viscosity = np.where(rate > 0, state.viscosity, state.viscosity_out)
    force = idle + state.gain * (law - idle) - viscosity * rate
    slope = idle_slope + state.gain * (law_slope - idle_slope) - viscosity * rate_gain
    if rate_gain:  # there is no friction at rest, before the first step
        friction, stuck = _friction(scene, p, contraction)
        force, slope = force - friction, slope - stuck
    return force, slope


def settle(scene: "Scene", p: Array, contraction: Array) -> None:
    """Keep the friction that a finished step ends with."""
    state = scene.muscle_state
    state.friction, _ = _friction(scene, p, contraction)
    state.contraction_before = contraction


def _friction(scene: "Scene", p: Array, contraction: Array) -> tuple[Array, Array]:
    """Return the friction [N] of one Maxwell-slip element, a spring that slips at the Coulomb limit and resists
    contraction; and its slope with contraction."""
    state = scene.muscle_state
    limit = state.friction_at_zero + state.friction_per_pressure * p
    trial = state.friction + limit / state.friction_slip * (contraction - state.contraction_before)
    return np.clip(trial, -limit, limit), np.where(np.abs(trial) < limit, limit / state.friction_slip, 0.0)


def _by_law(scene: "Scene", p: Array, contraction: Array) -> tuple[Array, Array]:
    """Return bilinear, beyond the table in contraction linear, tension and its slope with contraction."""
    tables, law = scene.tables, scene.law
    a = np.minimum(np.maximum(p, 0.0) / PRESSURE_STEP, tables.shape[1] - 1.000001)
    b = (contraction - _FIRST) / _SPACING
    ia, ib = a.astype(int), np.clip(b.astype(int), 0, tables.shape[2] - 2)
    lo, hi = ((1 - (a - ia)) * tables[law, ia, k] + (a - ia) * tables[law, ia + 1, k] for k in (ib, ib + 1))
    return lo + (b - ib) * (hi - lo), (hi - lo) / _SPACING
