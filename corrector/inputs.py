"""Inputs of the corrector from a case: the muscles as fields, the shape in its own frames, the recent past; and how far
a design is from others: where muscles lie, in which direction and on which side, and of what all is made.

Everything is local, so that a new layout is a new arrangement of known things: no places on the cloth, no directions in
the room and no names of muscles, only directions and sides relative to one another.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.spatial import cKDTree

from corrector.shape import NODES, LocalFrames
from fabdesign.geometry.shape import Shape, at_places, bilinear
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import MUSCLE_TYPES, Case
from fabdesign.nouns.lag import after, first_order
from fabdesign.nouns.muscle import MuscleType
from fabdesign.nouns.muscle_law import MuscleLaw, law_of
from fabdesign.nouns.pressure import PressureProgram

HISTORY = (1 / 30, 0.1, 0.3)  # s
_LAGS = (0.05, 0.2)  # s, of a first-order lag that the pressure may have
_FORCE, _PRESSURE, _CONTRACTION, _RATE, _SPEED, _LENGTH = 10.0, 400e3, 0.1, 0.5, 0.5, 0.1  # N, Pa, 1, 1/s, m/s, m
_STRAIN = 0.05
_SLIDING = 2e-3  # of contraction within the shortest span: more counts as a direction
_DENSITY = 50.0  # 1/m of muscle per area that counts as one
_SAMPLES = 8  # an interval between fixed points


@dataclass(frozen=True, eq=False)
class Interval:
    """The part of a muscle between two fixed points."""

    muscle: int
    start: Array  # (2,) (u, v) m
    end: Array  # (2,) (u, v) m
    along: float  # share of the muscle's length at its middle


def intervals_of(design: Design) -> list[Interval]:
    """Return all intervals, muscle by muscle."""
    intervals = []
    for m, muscle in enumerate(design.muscles):
        done, total = 0.0, muscle.length
        for a, b in pairwise(muscle.fixed_points()):
            length = float(np.linalg.norm(b - a))
            intervals.append(Interval(m, a, b, (done + length / 2) / total))
            done += length
    return intervals


def deposits(design: Design) -> Array:
    """Return (2, intervals, 3, NODES, NODES): on the front and on the back, how much of each interval lies around each
    node (rows: rising v, columns: rising u), times its direction's components uu, vv and uv.

    Length per area, spread over the four nodes around each piece, by `_DENSITY`; a straight muscle has about 1 on the
    nodes under it. What is spread so keeps its direction and side: a layout is an arrangement of the same pieces.
    """
    intervals = intervals_of(design)
    result = np.zeros((2, len(intervals), 3, NODES, NODES))
    if not intervals:
        return result
    size, order = np.array([design.fabric.width, design.fabric.height]), np.arange(len(intervals))
    start, way = np.array([i.start for i in intervals]), np.array([i.end - i.start for i in intervals])
    length = np.linalg.norm(way, axis=1)
    u, v = (way / length[:, None]).T
    shares = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    at = np.clip((start[:, None] + shares[:, None] * way[:, None]) / size, 0, 1) * (NODES - 1)
    points, weights = bilinear(at.reshape(-1, 2), NODES, NODES)
    around = np.zeros((len(intervals), NODES**2))
    np.add.at(around, (np.repeat(order, _SAMPLES), points.T), weights.T)
    amount = length / _SAMPLES / np.prod(size / (NODES - 1)) / _DENSITY
    side = [0 if design.muscles[i.muscle].side == "front" else 1 for i in intervals]
    pieces = np.stack([u * u, v * v, u * v], axis=1)[:, :, None] * (amount[:, None] * around)[:, None]
    result[side, order] = pieces.reshape(-1, 3, NODES, NODES)
    return result


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
    middle, program = Shape(motion).middle.astype(np.float32), case.program
    pressure = program.at(times) if case.design.channels else np.zeros((len(times), 1))
    last = np.searchsorted(program.time, times + 1e-9, side="right") - 1
    since = times - program.time[np.clip(last, 0, None)]
    return Fields(
        muscles=_muscle_fields(case, times, middle),
        **_shape_fields(case.design.fabric, middle),
        total=pressure.sum(axis=1) / _PRESSURE / 8,
        opened=(pressure > 1e3).sum(axis=1) / 8,
        since=np.exp(-since / np.array([[0.1], [0.4]])),
    )


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
    along_u = np.gradient(frames.normal, fabric.width / (NODES - 1), axis=-2)
    along_v = np.gradient(frames.normal, fabric.height / (NODES - 1), axis=-3)
    pairs = ((along_u, frames.across), (along_v, frames.down), (along_u, frames.down))  # uu, vv, uv
    parts = [-_LENGTH * np.einsum("...i,...i->...", a, b) for a, b in pairs]
    curvature = np.stack(parts, axis=2).astype(np.float64)  # (1 + H, T, 3, n, n)
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


def lagged(program: PressureProgram, times: Array, lag: float) -> Array:
    """Return (T, channels) Pa: the program through a first-order lag of `lag` s, from no pressure before t = 0.
    Exact."""
    held, idle = np.diff(program.time), np.zeros(program.pressure.shape[1])
    at_rows = first_order(program.pressure[:-1], held, lag, start=idle)
    row = np.maximum(np.searchsorted(program.time, times, side="right") - 1, 0)
    since = np.maximum(times - program.time[row], 0.0)[:, None]
    return after(at_rows[row], program.pressure[row], since, lag)


FAR = 1e9  # of a design that is held in another way
_PATCH = 3  # nodes a side: what lies within 30 mm of a node of a 0.2 m cloth
_FACTOR = 1.25  # between two constants that counts as a distance of one
_COMPARED = 200e3  # Pa, at which muscle types are compared


def described(design: Design) -> dict[str, Any]:
    """Return what `distance` compares, as lists and numbers that JSON takes."""
    fabric = design.fabric
    constants = {
        "width": fabric.width,
        "height": fabric.height,
        "thickness": fabric.thickness,
        "areal_density": fabric.areal_density,
        "membrane_1": fabric.membrane_stiffness[0],
        "membrane_2": fabric.membrane_stiffness[1],
        "shear": fabric.shear_stiffness,
        "bending_1": fabric.bending_stiffness[0],
        "bending_2": fabric.bending_stiffness[1],
    }
    return {
        "name": design.name,
        "held": [str(fabric.hung), fabric.support, *(float(g) for g in fabric.gravity)],
        "constants": constants,
        "muscles": [_constants_of(design.muscle_types[name]) for name in sorted({m.type for m in design.muscles})],
        "patches": _patches(design).round(4).tolist(),
    }


def _constants_of(kind: MuscleType) -> list[float]:
    """Return the axis offset [m] and tension [N] at the row of the bench nearest to `_COMPARED` and the rest length."""
    pressure, contraction = np.array(kind.bench.pressure), np.array(kind.bench.contraction)
    row = np.argmin(np.abs(pressure - _COMPARED) / _COMPARED + np.abs(contraction))
    return [kind.axis_offset, max(kind.bench.force[int(row)], 1e-3)]


def _patches(design: Design) -> Array:
    """Return (n^2, 6): around every node, how much muscle lies on the front and on the back, by direction."""
    field = deposits(design).sum(axis=1)  # (2, 3, n, n)
    smooth = uniform_filter(field, (1, 1, _PATCH, _PATCH), mode="nearest")
    return np.moveaxis(smooth.reshape(6, -1), 0, 1)


def distance(design: Mapping[str, Any], known: Sequence[Mapping[str, Any]]) -> float:
    """Return how far one design is from all the `known` ones together, as `described`; 0: nothing about it is new.

    Two parts, added: over the nodes, RMS of how far the muscles around one are from what some node of a known design
    has around it (1: one straight muscle more or less), and how far the constants are from the
    nearest known design's, in factors of 1.25.
    """
    alike = [other for other in known if list(other["held"]) == list(design["held"])]
    if not alike:
        return FAR
    apart = min(_constants_apart(design, other) for other in alike)
    tree = cKDTree(np.concatenate([np.asarray(other["patches"]).reshape(-1, 6) for other in alike]))
    away, _ = tree.query(np.asarray(design["patches"]).reshape(-1, 6))
    return float(np.sqrt(np.mean(np.square(_PATCH * away)))) + apart


def _constants_apart(one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    """Return the largest difference of logarithms, in logarithms of `_FACTOR`; of muscle types from the nearest one."""
    fabric = [_apart([one["constants"][name]], [other["constants"][name]]) for name in one["constants"]]
    muscles = [min((_apart(kind, known) for known in other["muscles"]), default=FAR) for kind in one["muscles"]]
    return max([*fabric, *muscles])


def _apart(one: Sequence[float], other: Sequence[float]) -> float:
    return float(np.abs(np.log(np.array(one) / np.array(other))).max() / np.log(_FACTOR))
