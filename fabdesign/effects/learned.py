"""Learned mechanics: coefficients of basis functions, where no physical effect is named.

The model is linear in each about nothing. Simulated with them, a motion of another layout, a shape at rest and the
search's derivatives follow from physics; a correction of points after the motion does not.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import ActingPressure, Effect, EffectParameter, Specimen, Values
from fabdesign.effects.fabric import ORTHOTROPY
from fabdesign.effects.muscle import BRAID_HYSTERESIS
from fabdesign.effects.pneumatics import lagged
from fabdesign.nouns.array import Array

UNIT = 200e3  # Pa, of which coefficients per pressure are told
QUICK, SLOW = 0.1, 0.5  # s, of the two lags
CURVATURES = "across", "down", "twist"
SLIP = BRAID_HYSTERESIS.parameters["slip"].typical


def _of_set_point(pressure: Array, values: Values) -> Array:
    """Return (n, channels) Pa."""
    share = pressure / UNIT
    others = share.sum(axis=1, keepdims=True) - share
    kept = 1.0 - values["drawn"] * others + values["bend"] * (share - 1.0)
    return np.asarray(pressure * np.maximum(kept, 0.0))


def _pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    changed = acting.at_once(lambda pressure: _of_set_point(pressure, values))
    quick, slow = values["quick"], values["slow"]
    if quick == 0 and slow == 0:
        return changed
    wanted = _of_set_point(acting.means, values)
    late = [share * (lagged(wanted, acting.tick, tau, tau) - wanted) for share, tau in ((quick, QUICK), (slow, SLOW))]
    return acting.through(changed.program, np.maximum(wanted + late[0] + late[1], 0.0))


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    stiffer = ORTHOTROPY.specimen
    assert stiffer is not None
    specimen = stiffer(specimen, {"ratio": float(np.exp(values["ratio"]))}, muscles)
    more = {f"rest_curvature_{name}": values[name] for name in CURVATURES} | {"air_drag": values["drag"]}
    specimen = specimen.with_constants(**{name: specimen.constants.get(name, 0.0) + more[name] for name in more})

    def known(name: str) -> Array:
        return specimen.muscles.get(name, np.zeros(len(muscles)))

    slip = known("friction_slip")
    return specimen.with_muscles(
        muscles,
        pressure_loss=np.clip(known("pressure_loss") + values["far"], 0.0, 1.0),
        friction_at_zero=known("friction_at_zero") + values["friction"],
        friction_slip=np.where(slip > 0, slip, SLIP),
        learned_stroke=known("learned_stroke") + values["stroke"],
        learned_spring=known("learned_spring") + values["spring"],
        learned_rate=known("learned_rate") + values["rate"],
    )


def _coefficient(unit: str, what: str, deviation: float, low: float, high: float) -> EffectParameter:
    return EffectParameter(unit, what, 0.0, (low, high), deviation, off=0.0)


LEARNED = Effect(
    "learned",
    site="learned",
    scope="rig",
    what="pressure, tension, friction, drag, curvature and stiffness beyond the model, each by a coefficient",
    signature="none of its own: what several effects leave together, on every layout",
    looks_like="each effect that it stands for; name that one with a trace where the mechanism matters",
    source="linear regression inside the forward model; docs/corrector.md",
    named=False,
    parameters={
        "quick": _coefficient("1", "share of the pressure that is 0.1 s late", 0.5, -1.0, 1.5),
        "slow": _coefficient("1", "share that is 0.5 s late", 0.3, -1.0, 1.5),
        "drawn": _coefficient("1", "share lost by 200 kPa in other channels", 0.05, -0.3, 0.3),
        "bend": _coefficient("1", "share gained at 400 kPa, and lost towards none", 0.15, -0.6, 0.6),
        "far": _coefficient("1", "share lost at a muscle's far end", 0.25, 0.0, 1.0),
        "stroke": _coefficient("N", "tension by contraction, at 200 kPa", 20.0, -200.0, 200.0),
        "spring": _coefficient("N", "tension by contraction, at any pressure", 20.0, -200.0, 200.0),
        "rate": _coefficient("N s", "tension lost by the contraction's rate, at 200 kPa", 5.0, -20.0, 100.0),
        "friction": _coefficient("N", "of a muscle against contraction and lengthening", 0.3, 0.0, 10.0),
        "across": _coefficient("1/m", "curvature of the free cloth along u", 1.0, -20.0, 20.0),
        "down": _coefficient("1/m", "along v", 1.0, -20.0, 20.0),
        "twist": _coefficient("1/m", "x,uv . n", 1.0, -20.0, 20.0),
        "ratio": _coefficient("1", "logarithm of stiffness across over down", 0.5, -2.0, 2.0),
        "drag": _coefficient("N s^2/m^4", "of air, on |v_n| v_n", 3.0, 0.0, 100.0),
    },
    pressure=_pressure,
    specimen=_specimen,
    force="sim.effects:LEARNED",
    remembers=True,
)

DISCOVERED = replace(
    LEARNED,
    name="discovered",
    what="what a trace found where no named effect explains the data: few of the coefficients of `learned`",
    looks_like="an effect that nobody has declared; its formula says where to look",
)

# What each coefficient adds, and to what: p pressure [Pa], T tension [N], e contraction, s the share of a muscle's way.
_ADDS = {
    "quick": ("p", "{:+.3g} (p late by 0.1 s - p)"),
    "slow": ("p", "{:+.3g} (p late by 0.5 s - p)"),
    "drawn": ("p", "{:+.3g} p (sum of the other channels / 200 kPa)"),
    "bend": ("p", "{:+.3g} p (p / 200 kPa - 1)"),
    "far": ("p", "{:+.3g} p s"),
    "stroke": ("T", "{:+.3g} N e p / 200 kPa"),
    "spring": ("T", "{:+.3g} N e"),
    "rate": ("T", "{:+.3g} N s (de/dt) p / 200 kPa"),
    "friction": ("T", "{:+.3g} N sign(de/dt)"),
    "across": ("curvature along u", "{:+.3g} 1/m"),
    "down": ("curvature along v", "{:+.3g} 1/m"),
    "twist": ("twist", "{:+.3g} 1/m"),
    "ratio": ("log(stiffness across / down)", "{:+.3g}"),
    "drag": ("force on an area", "{:+.3g} N s^2/m^4 |v_n| v_n"),
}
_LOSSES = "drawn", "far", "rate", "friction", "drag"  # coefficients of what is taken away


def formula(values: Values) -> str:
    """Return what coefficients of `learned` that are not zero add, as text: "p +0.12 p (p / 200 kPa - 1); T -3 N e"."""
    added: dict[str, list[str]] = {}
    for name, (to, text) in _ADDS.items():
        if value := values.get(name, 0.0):
            added.setdefault(to, []).append(text.format(-value if name in _LOSSES else value))
    return "; ".join(" ".join([to, *terms]) for to, terms in added.items())
