"""What the network sees of a case: the muscles as fields, the shape in its own frames, the recent past.

Everything is local, so that a new layout is a new arrangement of known things: no places on the cloth, no directions in
the room and no names of muscles, only directions and sides relative to one another.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from corrector.layout import NODES, deposits, intervals_of
from corrector.shape import Frames, middle_of
from fabdesign.design import Design
from fabdesign.fabric import Fabric
from fabdesign.forward import MUSCLE_TYPES, Case
from fabdesign.muscle_law import MuscleLaw
from fabdesign.pressure import PressureProgram

Array = NDArray[np.float64]

HISTORY = (1 / 30, 0.1, 0.3)  # s
_LAGS = (0.05, 0.2)  # s, of a first-order lag that the pressure may have
_FORCE, _PRESSURE, _CONTRACTION, _RATE, _SPEED, _LENGTH = 10.0, 400e3, 0.1, 0.5, 0.5, 0.1  # N, Pa, 1, 1/s, m/s, m

MUSCLE = (
    "presence",
    "tension",
    "pressure",
    "contraction",
    "contraction rate",
    "contraction since 0.3 s",
    "pressure that a lag of 0.05 s holds back",
    "pressure that a lag of 0.2 s holds back",
    "pressure towards the path's end",
)
SHAPE = 3 + 3 + 3 * 3 + 2 * 3  # curvature, strain, velocity over three spans, change of curvature over two
COMMON = 6
CHANNELS = 6 * len(MUSCLE) + SHAPE + COMMON
# of each channel: its sign when the cloth is mirrored left to right, and when its faces are exchanged
_TENSOR_U = (1, 1, -1)  # uu, vv, uv
_SHAPE_U = _TENSOR_U + _TENSOR_U + (-1, 1, 1) * 3 + _TENSOR_U * 2
_SHAPE_Z = (-1,) * 3 + (1,) * 3 + (1, 1, -1) * 3 + (-1,) * 6
SIGNS_U = np.array(_TENSOR_U * (2 * len(MUSCLE)) + _SHAPE_U + (1,) * COMMON, dtype=np.float32)
SIGNS_Z = np.array((1,) * (6 * len(MUSCLE)) + _SHAPE_Z + (1,) * COMMON, dtype=np.float32)
# uu changes place with vv, and u with v, when the cloth is turned over its diagonal: the first two of every three
TURNED_CHANNELS = np.concatenate(
    [np.arange(CHANNELS - COMMON).reshape(-1, 3)[:, [1, 0, 2]].ravel(), np.arange(CHANNELS - COMMON, CHANNELS)]
)


def mirrored(inputs: NDArray[np.float32]) -> NDArray[np.float32]:
    """Inputs (..., CHANNELS, n, n) of the cloth mirrored left to right."""
    return np.ascontiguousarray(inputs[..., ::-1] * SIGNS_U[:, None, None])


def exchanged(inputs: NDArray[np.float32]) -> NDArray[np.float32]:
    """Inputs (..., CHANNELS, n, n) of the cloth with its faces exchanged, mirrored front to back."""
    each = 3 * len(MUSCLE)
    order = np.r_[each : 2 * each, :each, 2 * each : CHANNELS]
    return np.ascontiguousarray(inputs[..., order, :, :] * SIGNS_Z[:, None, None])


def turned(inputs: NDArray[np.float32]) -> NDArray[np.float32]:
    """Inputs (..., CHANNELS, n, n) of the cloth turned over its diagonal, u for v: what happens at a place does not
    know where gravity points."""
    return np.ascontiguousarray(np.swapaxes(inputs[..., TURNED_CHANNELS, :, :], -1, -2))


@dataclass(frozen=True, eq=False)
class Layout:
    """What is the same in every frame of a design."""

    design: Design
    deposits: Array  # (2, intervals, 3, n, n)
    laws: dict[str, MuscleLaw]

    @staticmethod
    def of(design: Design) -> "Layout":
        laws = {name: MuscleLaw.fit(design.muscle_types[name].bench) for name in {m.type for m in design.muscles}}
        return Layout(design, deposits(design), laws)


def inputs_of(case: Case, layout: Layout, times: Array, motion: NDArray[np.floating]) -> NDArray[np.float32]:
    """(T, CHANNELS, n, n) of a case at `times` (T,) s.

    motion: (1 + H, T, 2 side^2, 3) m, simulated at the times themselves, then `HISTORY` seconds before each.
    """
    side = round((motion.shape[2] // 2) ** 0.5)
    middle = middle_of(motion, side).astype(np.float32)
    muscles = _muscle_fields(case, layout, times, middle)
    shape = _shape_fields(case.design.fabric, middle)
    return np.concatenate([muscles, shape, _common(case, times, shape.shape[-1])], axis=1).astype(np.float32)


def _muscle_fields(case: Case, layout: Layout, times: Array, middle: NDArray[np.float32]) -> NDArray[np.float64]:
    design = case.design
    intervals = intervals_of(design)
    nodes = layout.deposits.shape[-1]
    if not intervals:
        return np.zeros((len(times), 6 * len(MUSCLE), nodes, nodes))
    contraction = _contractions(case, middle)  # (1 + H, T, intervals)
    channel = np.array([design.muscles[i.muscle].channel for i in intervals])
    pressure = case.program.at(times)[:, channel]
    lagging = [pressure - lagged(case.program, times, lag)[:, channel] for lag in _LAGS]
    tension = np.empty_like(pressure)
    types = np.array([design.muscles[i.muscle].type for i in intervals])
    for name, law in layout.laws.items():
        own = types == name
        idle = law.tension(0.0, contraction[0][:, own])
        tension[:, own] = idle + _factor(case, name, "muscle_gain") * (
            law.tension(pressure[:, own], contraction[0][:, own]) - idle
        )
    values = np.stack(
        [
            np.ones_like(pressure),
            tension / _FORCE,
            pressure / _PRESSURE,
            contraction[0] / _CONTRACTION,
            (contraction[0] - contraction[1]) / HISTORY[0] / _RATE,
            (contraction[0] - contraction[3]) / _CONTRACTION,
            lagging[0] / _PRESSURE,
            lagging[1] / _PRESSURE,
            pressure / _PRESSURE * (2 * np.array([i.along for i in intervals]) - 1),
        ]
    )  # (kinds, T, intervals)
    fields = np.einsum("kti,sicab->tskcab", values, layout.deposits, optimize=True)
    return np.asarray(fields.reshape(len(times), 6 * len(MUSCLE), nodes, nodes))


def _factor(case: Case, muscle_type: str, name: str) -> float:
    return case.factors.get(f"{MUSCLE_TYPES}{muscle_type}.{name}", case.factors.get(name, 1.0))


def _contractions(case: Case, middle: NDArray[np.float32]) -> Array:
    """(1 + H, T, intervals), 1 - l / l0, of muscles that lie their axis offset off the mid-surface."""
    design, side = case.design, middle.shape[-2]
    fabric = design.fabric
    normal = Frames.of(middle, fabric.width, fabric.height, side).normal
    result = []
    for muscle in design.muscles:
        offset = design.muscle_types[muscle.type].axis_offset * (1 if muscle.side == "front" else -1)
        offset *= _factor(case, muscle.type, "axis_offset")
        fixed = muscle.fixed_points()
        x = np.clip(fixed / (fabric.width, fabric.height), 0, 1) * (side - 1)
        first = np.minimum(x.astype(int), side - 2)
        u, v = (x - first).T[:, :, None]
        (col, row) = first.T
        place = 0.0
        for r, c, weight in ((0, 0, (1 - u) * (1 - v)), (0, 1, u * (1 - v)), (1, 0, (1 - u) * v), (1, 1, u * v)):
            at = middle[..., row + r, col + c, :] + offset * normal[..., row + r, col + c, :]
            place = place + weight * at
        length = np.linalg.norm(np.diff(place, axis=-2), axis=-1)
        result.append(1 - length / np.linalg.norm(np.diff(fixed, axis=0), axis=1))
    return np.concatenate(result, axis=-1)


def _shape_fields(fabric: Fabric, middle: NDArray[np.float32]) -> NDArray[np.float32]:
    """(T, SHAPE, n, n)"""
    frames = Frames.of(middle, fabric.width, fabric.height, NODES)
    units = frames.units()[0]
    curvature = _curvatures(frames, fabric)  # (1 + H, T, n, n, 3)
    size_u, size_v = (np.linalg.norm(x[0], axis=-1) for x in (frames.across, frames.down))
    shear = np.einsum("...i,...i->...", frames.across[0], frames.down[0]) / (size_u * size_v)
    every = (middle.shape[-2] - 1) // (NODES - 1)
    places = middle[:, :, ::every, ::every]
    speeds = [(places[0] - places[h + 1]) / seconds / _SPEED for h, seconds in enumerate(HISTORY)]
    fields = [
        curvature[0],
        20 * np.stack([size_u - 1, size_v - 1, shear], axis=-1),
        *(np.einsum("...ij,...j->...i", units, speed) for speed in speeds),
        curvature[0] - curvature[2],
        curvature[0] - curvature[3],
    ]
    return np.moveaxis(np.concatenate(fields, axis=-1), -1, 1).astype(np.float32)


def _curvatures(frames: Frames, fabric: Fabric) -> NDArray[np.floating]:
    """(..., n, n, 3): uu, vv and uv, times `_LENGTH`."""
    n = frames.normal.shape[-2]
    along_u = np.gradient(frames.normal, fabric.width / (n - 1), axis=-2)
    along_v = np.gradient(frames.normal, fabric.height / (n - 1), axis=-3)
    pairs = ((along_u, frames.across), (along_v, frames.down), (along_u, frames.down))
    return np.stack([-_LENGTH * np.einsum("...i,...i->...", a, b) for a, b in pairs], axis=-1)


def _common(case: Case, times: Array, n: int) -> Array:
    """(T, COMMON, n, n): what is the same all over the cloth in a frame."""
    program, channels = case.program, max(case.design.channels, 1)
    pressure = program.at(times) if case.design.channels else np.zeros((len(times), 1))
    last = np.searchsorted(program.time, times + 1e-9, side="right") - 1
    since = times - program.time[np.clip(last, 0, None)]
    rows = np.stack(
        [
            pressure.sum(axis=1) / _PRESSURE / 8,
            pressure.mean(axis=1) / _PRESSURE,
            (pressure > 1e3).sum(axis=1) / 8,
            (pressure > 1e3).sum(axis=1) / channels,
            np.exp(-since / 0.1),
            np.exp(-since / 0.4),
        ],
        axis=1,
    )
    return np.repeat(rows[:, :, None], n * n, axis=2).reshape(len(times), COMMON, n, n)


def lagged(program: PressureProgram, times: Array, lag: float) -> Array:
    """(T, channels) Pa: the program through a first-order lag of `lag` s, from no pressure before t = 0. Exact."""
    ends = np.append(program.time[1:], np.inf)
    result = np.zeros((len(times), program.pressure.shape[1]))
    for start, end, level in zip(program.time, ends, program.pressure, strict=True):
        begun = np.maximum(times - start, 0)
        over = np.maximum(times - end, 0)
        result += np.where(times > start, np.exp(-over / lag) - np.exp(-begun / lag), 0.0)[:, None] * level
    return result
