"""Learned mechanics: coefficients of basis functions, where no physical effect is named.

The model is linear in each about nothing. Simulated with them, a motion of another layout, a shape at rest and the
search's derivatives follow from physics; a correction of points after the motion does not.
"""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import ActingPressure, Specimen, Values, built_in
from fabdesign.effects.mechanisms import lagged, orthotropy_specimen
from fabdesign.nouns.array import Array

UNIT = 200e3  # Pa, of which coefficients per pressure are told
QUICK, SLOW = 0.1, 0.5  # s, of the two lags
CURVATURES = "across", "down", "twist"
SLIP = built_in()["braid_hysteresis"]["parameters"]["slip"]["typical"]


def _of_set_point(pressure: Array, values: Values) -> Array:
    """Return (n, channels) Pa."""
    share = pressure / UNIT
    others = share.sum(axis=1, keepdims=True) - share
    kept = 1.0 - values["drawn"] * others + values["bend"] * (share - 1.0)
    return np.asarray(pressure * np.maximum(kept, 0.0))


def learned_pressure(acting: ActingPressure, values: Values) -> ActingPressure:
    changed = acting.at_once(lambda pressure: _of_set_point(pressure, values))
    quick, slow = values["quick"], values["slow"]
    if quick == 0 and slow == 0:
        return changed
    wanted = _of_set_point(acting.means, values)
    late = [share * (lagged(wanted, acting.tick, tau, tau) - wanted) for share, tau in ((quick, QUICK), (slow, SLOW))]
    return acting.through(changed.program, np.maximum(wanted + late[0] + late[1], 0.0))


def learned_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    specimen = orthotropy_specimen(specimen, {"ratio": float(np.exp(values["ratio"]))}, muscles)
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
