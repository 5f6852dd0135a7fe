"""Mechanisms of the built-in effects, as their tables (data/effects.toml) name them: what they change of a specimen, of
pressures, of a muscle's record on its bench, and of what is observed."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import ActingPressure, MuscleRecord, Specimen, Values
from fabdesign.files.law_tables import MembraneCurve
from fabdesign.nouns.array import Array
from fabdesign.nouns.lag import SHORTEST, after, first_order
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.units import from_kpa


# Threshold pressure: a muscle's bladder must be blown up before pressure contracts the braid.
def threshold_pressure_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    threshold, width = from_kpa(values["threshold"]), from_kpa(values["width"])
    # so a threshold of nothing leaves the pressure as it is; from 2 (4) widths on the width is right to 4 (0.1) %
    narrowed = width * np.tanh(threshold / width)
    return specimen.with_muscles(muscles, threshold_pressure=threshold, threshold_width=narrowed)


# Braid hysteresis: Coulomb friction of strand on strand, which grows with pressure.
def braid_hysteresis_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_muscles(
        muscles,
        friction_per_pressure=values["friction"] / from_kpa(1.0),  # N/Pa
        friction_at_zero=values["friction_at_zero"],
        friction_slip=values["slip"],
    )


def braid_hysteresis_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    limit = values["friction_at_zero"] + values["friction"] / from_kpa(1.0) * record.pressure
    drawn = np.diff(record.contraction, axis=0, prepend=record.contraction[:1])
    force, forces = np.zeros(drawn.shape[1:]), []
    for most, more in zip(limit, drawn, strict=True):
        force = np.clip(force + most / values["slip"] * more, -most, most)
        forces.append(force)
    return replace(record, friction=record.friction + np.array(forces))


# Muscle creep: part of a muscle's contraction comes slowly, and goes slowly.
def muscle_creep_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    limit = values["share"] * np.maximum(record.contraction, 0.0)
    lent = first_order(limit[1:], np.diff(record.time), values["time"], start=limit[0])
    return replace(record, lent=record.lent + lent - values["on_bench"] * limit)


# Muscle viscosity: tension lost by the rate of contraction, another share while lengthening.
def muscle_viscosity_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    viscosity = np.where(record.rate > 0, values["contracting"], values["lengthening"])
    return replace(record, friction=record.friction + viscosity * record.rate)


# Stroke softening: muscles pull less from trial to trial of a session.
def stroke_softening_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    remaining = 1.0 + values["loss"] * np.expm1(-specimen.order / values["trials"])
    return specimen.with_muscles(muscles, gain=specimen.muscles["gain"] * remaining)


# Odd muscle: the muscles of one channel pull with a gain of their own.
def odd_muscle_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    odd = np.array([muscle.channel == int(values["channel"]) for muscle in specimen.design.muscles], dtype=bool)
    return specimen.with_muscles(odd & muscles, gain=specimen.muscles["gain"] * values["factor"])


# Filling lag: the pressure in a muscle follows the set point with a time constant, which may differ emptying.
ROUNDED = 3  # decimals of Pa


def lagged(wanted: Array, tick: float, fill: float, empty: float) -> Array:
    """Return (ticks, channels) Pa, means of p over ticks, where dp/dt = (wanted - p) / tau and p = 0 at the begin; tau
    = fill where p rises, empty where it falls [s]. Exact for a wanted pressure that is constant within each tick."""
    wanted = np.round(wanted, ROUNDED)  # what differs by rounding alone would count as a change in every tick
    out = np.empty_like(wanted)
    p = np.zeros(wanted.shape[1])
    changes = np.flatnonzero((np.diff(wanted, axis=0) != 0).any(axis=1)) + 1
    for begin, end in pairwise([0, *changes.tolist(), len(wanted)]):
        goal = wanted[begin]
        tau = np.maximum(np.where(goal > p, fill, empty), SHORTEST)
        remaining = np.exp(-tick * np.arange(end - begin + 1)[:, None] / tau)  # of the gap, at the ticks' edges
        out[begin:end] = goal + (p - goal) * (remaining[:-1] - remaining[1:]) * tau / tick
        p = after(p, goal, tick * (end - begin), tau)
    return out


def filling_lag_pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    fill, empty = values["fill"], values["empty"]
    if max(fill, empty) <= SHORTEST:
        return acting
    return acting.through(acting.program, lagged(acting.means, acting.tick, fill, empty))


def filling_lag_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    """Return a row's pressure is set until the next row."""
    goals, steps = record.pressure[:-1], np.diff(record.time)
    pressure = first_order(goals, steps, values["fill"], start=record.pressure[0], falling=values["empty"])
    return replace(record, pressure=pressure)


# Dead time: what a regulator is told acts later.
def dead_time_pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    delay = values["delay"]
    if delay <= 0:
        return acting
    set_points = acting.program
    program = PressureProgram(
        np.concatenate([[0.0], set_points.time + delay]),
        np.concatenate([np.zeros((1, set_points.pressure.shape[1])), set_points.pressure]),
        set_points.duration,
    )
    if acting.smooth is None:
        return acting.through(program, None)
    edges = acting.tick * np.arange(acting.ticks + 1)
    integral = np.concatenate([np.zeros((1, acting.smooth.shape[1])), acting.tick * np.cumsum(acting.smooth, axis=0)])
    late = np.stack([np.interp(edges - delay, edges, column) for column in integral.T], axis=1)
    return acting.through(program, np.diff(late, axis=0) / acting.tick)


def dead_time_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    late = np.interp(record.time - values["delay"], record.time, record.pressure)
    return replace(record, pressure=late)


# Supply droop: open channels lower each other's pressure.
OPEN = 5e3  # Pa, above which a channel draws from the supply


def supply_droop_pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    def drooped(pressure: Array) -> Array:
        is_open = pressure > OPEN
        others = is_open.sum(axis=1, keepdims=True) - is_open
        return np.asarray(pressure * np.maximum(1.0 - values["share"] * others, 0.0))

    return acting.at_once(drooped)


# Orthotropy: the cloth is stiffer one way than its data sheet says.
def orthotropy_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    fabric, root = specimen.design.fabric, values["ratio"] ** 0.5
    if values["ratio"] == 1:
        return specimen
    (k1, k2), (b1, b2) = fabric.membrane_stiffness, fabric.bending_stiffness
    # nu_12 / k_1 = nu_21 / k_2: nu_12 nu_21 stays, and so do the plate's coupled and twist stiffness
    changed = replace(
        fabric,
        membrane_stiffness=(k1 * root, k2 / root),
        bending_stiffness=(b1 * root, b2 / root),
        poisson=fabric.poisson * root,
    )
    if fabric.membrane_curve is not None:
        curve = fabric.membrane_curve
        across, down = (
            tuple(factor * t for t in tension) for factor, tension in zip((root, 1 / root), curve.tension, strict=True)
        )
        changed = replace(changed, membrane_curve=MembraneCurve(curve.strain, (across, down)))
    return specimen.with_fabric(changed)


# Local stiffening: a disc of the cloth is stiffer, as under a seam's end, a patch or glue.
EDGE = 0.004  # m, over which the disc fades out


def local_stiffening_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    before = specimen.places.get("stiffer")

    def stiffer(u: Array, v: Array) -> Array:
        beyond = np.hypot(u - values["u"], v - values["v"]) - values["radius"]
        inside = 0.5 * (1.0 - np.tanh(beyond / (EDGE / 2)))  # 1 / (1 + exp(4 beyond / EDGE))
        factor = 1.0 + (values["factor"] - 1.0) * inside
        return np.asarray(factor * (1.0 if before is None else 1.0 + before(u, v)) - 1.0)

    return specimen.with_place("stiffer", stiffer)


# Frame tilt: the frame leans, so that gravity does not point down the cloth.
def frame_tilt_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    a, c = np.radians(values["about_x"]), np.radians(values["about_z"])
    turn_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    turn_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    fabric = specimen.design.fabric
    x, y, z = (turn_z @ turn_x @ np.array(fabric.gravity)).tolist()
    return specimen.with_fabric(replace(fabric, gravity=(x, y, z)))


# Added mass: something is fixed to one point of the cloth.
def added_mass_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    fabric = specimen.design.fabric
    u, v = min(values["u"], fabric.width), min(values["v"], fabric.height)
    return specimen.with_mass(u, v, values["mass"])


# Registration bias: the cameras' world is turned and shifted against the frame's, always alike.
def turning(about_x: float, about_y: float, about_z: float) -> Array:
    """Return (3, 3) of turns [rad] about the world's x axis, then its y, then its z axis."""
    turn = np.eye(3)
    for axis, angle in enumerate((about_x, about_y, about_z)):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        one = np.eye(3)
        one[i, i] = one[j, j] = np.cos(angle)
        one[j, i], one[i, j] = np.sin(angle), -np.sin(angle)
        turn = one @ turn
    return turn


def registration_bias_observed(points: NDArray[Any], values: Values) -> NDArray[Any]:
    turn = turning(*(np.radians(values[f"about_{axis}"]) for axis in "xyz"))
    return np.asarray(points @ turn.T + np.array([values[axis] for axis in "xyz"]))


# Time offset: a frame shows the cloth as it was before the frame's time.
def time_offset_clock(times: Array, values: Values) -> Array:
    return np.maximum(times - values["offset"], 0.0)


# Scale error: all lengths that the cameras give are wrong by one factor.
def scale_error_observed(points: NDArray[Any], values: Values) -> NDArray[Any]:
    return points * (1.0 + values["scale"])
