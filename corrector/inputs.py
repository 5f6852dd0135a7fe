"""Inputs of the corrector from a case: the muscles as fields, the shape in its own frames, the recent past.

Everything is local, so that a new layout is a new arrangement of known things: no places on the cloth, no directions in
the room and no names of muscles, only directions and sides relative to one another.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from corrector.layout import NODES, deposits, intervals_of
from corrector.shape import LocalFrames
from fabdesign.geometry.shape import Shape, at_places
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import MUSCLE_TYPES, Case
from fabdesign.nouns.lag import after, first_order
from fabdesign.nouns.muscle_law import MuscleLaw, law_of
from fabdesign.nouns.pressure import PressureProgram

HISTORY = (1 / 30, 0.1, 0.3)  # s
_LAGS = (0.05, 0.2)  # s, of a first-order lag that the pressure may have
_FORCE, _PRESSURE, _CONTRACTION, _RATE, _SPEED, _LENGTH = 10.0, 400e3, 0.1, 0.5, 0.5, 0.1  # N, Pa, 1, 1/s, m/s, m
_STRAIN = 0.05
_SLIDING = 2e-3  # of contraction within the shortest span: more counts as a direction


@dataclass(frozen=True, eq=False)
class Fields:
    """T frames on n x n nodes; tensors by their components uu, vv, uv. Scaled to about 1."""

    muscles: Array  # (T, 2, len(MUSCLE), 3, n, n) on the front and on the back
    curvature: Array  # (T, 3, n, n)
    strain: Array  # (T, 3, n, n)
    changes: Array  # (2, T, 3, n, n) of curvature, over 0.1 and 0.3 s
    speeds: Array  # (3, T, n, n) along the normal, mean over each span of `HISTORY`
    total: Array  # (T,) pressure, of all channels
    opened: Array  # (T,) number of open channels
    since: Array  # (2, T) of the last step of pressure: exp(-t / 0.1 s) and exp(-t / 0.4 s)


def _kinds(pressure: Array, tension: Array, contraction: Array, lagging: Array, along: Array) -> dict[str, Array]:
    """Return (T, intervals) of each kind of field. pressure: (T, intervals) Pa, lagging: (2, T, intervals) Pa that the
    lags hold back of it, tension: N, contraction: (1 + H, T, intervals), along: (intervals,) from -1 to 1."""
    p, short = pressure / _PRESSURE, contraction[0] / _CONTRACTION
    change = contraction[0] - contraction[1]
    return {
        "presence": np.ones_like(p),
        "tension": tension / _FORCE,
        "pressure": p,
        "contraction": short,
        "contraction rate": change / HISTORY[0] / _RATE,
        "contraction since 0.3 s": (contraction[0] - contraction[3]) / _CONTRACTION,
        "pressure that a lag of 0.05 s holds back": lagging[0] / _PRESSURE,
        "pressure that a lag of 0.2 s holds back": lagging[1] / _PRESSURE,
        "pressure towards the path's end": p * along,
        "pressure squared": p**2,
        "pressure times contraction": p * short,
        "contraction squared": short**2,
        "root of pressure": np.sqrt(p),
        "under pressure": p > 0,
        "pressure cubed": p**3,
        "pressure squared times contraction": p**2 * short,
        "contraction, where shortened": np.maximum(short, 0),
        "place along the path": np.broadcast_to(along, p.shape),
        "pressure, signed by the rate's direction": p * np.tanh(change / _SLIDING),
    }


MUSCLE = tuple(_kinds(*(np.zeros(shape) for shape in ((0, 0), (0, 0), (1 + len(HISTORY), 0, 0), (2, 0, 0), 0))))


def fields_of(case: Case, times: Array, motion: NDArray[np.floating]) -> Fields:
    """Return the fields of a case at `times` (T,) s.

    motion: (1 + H, T, 2 side^2, 3) m, simulated at the times themselves, then `HISTORY` seconds before each.
    """
    middle = Shape(motion).middle.astype(np.float32)
    common = _shape_fields(case.design.fabric, middle) | _common(case, times)
    return Fields(muscles=_muscle_fields(case, times, middle), **common)


def laws_of(design: Design) -> dict[str, MuscleLaw]:
    """Return the laws of the design's muscles, by type."""
    return {name: law_of(design.muscle_types[name].bench) for name in {m.type for m in design.muscles}}


def _muscle_fields(case: Case, times: Array, middle: NDArray[np.float32]) -> Array:
    design = case.design
    intervals = intervals_of(design)
    if not intervals:
        return np.zeros((len(times), 2, len(MUSCLE), 3, NODES, NODES))
    contraction = _contractions(case, middle)  # (1 + H, T, intervals)
    channel = np.array([design.muscles[i.muscle].channel for i in intervals])
    pressure = case.program.at(times)[:, channel]
    lagging = np.array([pressure - lagged(case.program, times, lag)[:, channel] for lag in _LAGS])
    tension = np.empty_like(pressure)
    types = np.array([design.muscles[i.muscle].type for i in intervals])
    for name, law in laws_of(design).items():
        of_type = types == name
        idle = law.tension(0.0, contraction[0][:, of_type])
        tension[:, of_type] = idle + _factor(case, name, "muscle_gain") * (
            law.tension(pressure[:, of_type], contraction[0][:, of_type]) - idle
        )
    along = 2 * np.array([i.along for i in intervals]) - 1
    values = np.stack([*_kinds(pressure, tension, contraction, lagging, along).values()])
    return np.asarray(np.einsum("kti,sicab->tskcab", values, deposits(design), optimize=True))


def _factor(case: Case, muscle_type: str, name: str) -> float:
    return case.factors.get(f"{MUSCLE_TYPES}{muscle_type}.{name}", case.factors.get(name, 1.0))


def _contractions(case: Case, middle: NDArray[np.float32]) -> Array:
    """Return (1 + H, T, intervals), 1 - l / l0, of muscles that lie their axis offset off the mid-surface."""
    design, fabric = case.design, case.design.fabric
    normal = LocalFrames.of(middle, fabric.width, fabric.height, middle.shape[-2]).normal
    result = []
    for muscle in design.muscles:
        offset = design.muscle_types[muscle.type].axis_offset * (1 if muscle.side == "front" else -1)
        offset *= _factor(case, muscle.type, "axis_offset")
        fixed = muscle.fixed_points()
        axis = at_places(middle + offset * normal, np.clip(fixed / (fabric.width, fabric.height), 0, 1))
        length = np.linalg.norm(np.diff(axis, axis=-2), axis=-1)
        result.append(1 - length / np.linalg.norm(np.diff(fixed, axis=0), axis=1))
    return np.concatenate(result, axis=-1)


def _shape_fields(fabric: Fabric, middle: NDArray[np.float32]) -> dict[str, Array]:
    """Return `Fields.curvature`, `strain`, `changes`, `speeds`."""
    frames = LocalFrames.of(middle, fabric.width, fabric.height, NODES)
    curvature = np.moveaxis(_curvatures(frames, fabric), -1, 2).astype(np.float64)  # (1 + H, T, 3, n, n)
    size_u, size_v = (size[0, ..., 0] for size in frames.sizes)
    shear = np.einsum("...i,...i->...", frames.across[0], frames.down[0]) / (size_u * size_v)
    strain = np.stack([size_u - 1, size_v - 1, shear], axis=1) / _STRAIN
    every = (middle.shape[-2] - 1) // (NODES - 1)
    places = middle[:, :, ::every, ::every]
    speeds = [(places[0] - places[h + 1]) / seconds / _SPEED for h, seconds in enumerate(HISTORY)]
    along = np.array([np.einsum("...i,...i->...", frames.normal[0], speed) for speed in speeds])
    return {
        "curvature": curvature[0],
        "strain": strain.astype(np.float64),
        "changes": curvature[0] - curvature[2:],
        "speeds": along.astype(np.float64),
    }


def _curvatures(frames: LocalFrames, fabric: Fabric) -> NDArray[np.floating]:
    """Return (..., n, n, 3): uu, vv and uv, times `_LENGTH`."""
    n = frames.normal.shape[-2]
    along_u = np.gradient(frames.normal, fabric.width / (n - 1), axis=-2)
    along_v = np.gradient(frames.normal, fabric.height / (n - 1), axis=-3)
    pairs = ((along_u, frames.across), (along_v, frames.down), (along_u, frames.down))
    return np.stack([-_LENGTH * np.einsum("...i,...i->...", a, b) for a, b in pairs], axis=-1)


def _common(case: Case, times: Array) -> dict[str, Array]:
    """Return `Fields.total`, `opened`, `since`."""
    program = case.program
    pressure = program.at(times) if case.design.channels else np.zeros((len(times), 1))
    last = np.searchsorted(program.time, times + 1e-9, side="right") - 1
    since = times - program.time[np.clip(last, 0, None)]
    total, opened = pressure.sum(axis=1) / _PRESSURE / 8, (pressure > 1e3).sum(axis=1) / 8
    return {"total": total, "opened": opened, "since": np.exp(-since / np.array([[0.1], [0.4]]))}


def lagged(program: PressureProgram, times: Array, lag: float) -> Array:
    """Return (T, channels) Pa: the program through a first-order lag of `lag` s, from no pressure before t = 0.
    Exact."""
    held, idle = np.diff(program.time), np.zeros(program.pressure.shape[1])
    at_rows = first_order(program.pressure[:-1], held, lag, start=idle)
    row = np.maximum(np.searchsorted(program.time, times, side="right") - 1, 0)
    since = np.maximum(times - program.time[row], 0.0)[:, None]
    return after(at_rows[row], program.pressure[row], since, lag)
