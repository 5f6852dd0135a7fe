"""Tension of every cable interval: the bench law, viscosity, and what muscle effects add."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from studies.rig.scene import CONTRACTIONS, PRESSURE_STEP, Scene

Array = NDArray[np.float64]
_FIRST, _SPACING = float(CONTRACTIONS[0]), float(CONTRACTIONS[1] - CONTRACTIONS[0])


def pressure_at_intervals(scene: Scene, pressure: Array) -> Array:
    """Return (intervals,) Pa that act in the muscles, from (channels,) Pa at the regulators."""
    state = scene.muscle_state
    p = pressure[scene.channel] * state.pressure_factor
    if state.threshold:
        w = state.threshold_width
        p = w * np.logaddexp(0.0, (p - state.threshold) / w) if w else np.maximum(p - state.threshold, 0.0)
    return np.asarray(p)


def tension(scene: Scene, p: Array, contraction: Array, rate: Array, rate_gain: float) -> tuple[Array, Array]:
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


def settle(scene: Scene, p: Array, contraction: Array) -> None:
    """Keep the friction that a finished step ends with; there is none at rest, before the first step."""
    state = scene.muscle_state
    limit = state.friction_at_zero + state.friction_per_pressure * p
    if limit.any() and len(state.contraction_before):
        state.friction, _ = _friction(scene, limit, contraction)
    state.contraction_before = contraction


def _friction(scene: Scene, limit: Array, contraction: Array) -> tuple[Array, NDArray[np.bool_]]:
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
