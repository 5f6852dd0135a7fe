"""Effects that no list of known ones has (* in docs/rig.md): an honest trace leaves them unexplained. And listed
ones in another form than the simulator's: the same cause by another law, as a laboratory would have it. Whoever looks
for causes should name the listed effect, with the parameters nearest to it."""

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from fabdesign.nouns.array import Array
from fabdesign.units import from_kpa
from studies.rig.effects.listed import load_along_normals
from studies.rig.scene import Scene, StepReport, effect, pressure_effect

FULL_PRESSURE = 4e5  # Pa, at which a muscle warms at its full rate, and a channel draws its whole share
# name -> the listed effect whose cause is the same
OF = {
    "lag_of_two_volumes": "filling_lag",
    "creep_of_two_times": "muscle_creep",
    "orthotropy_of_bending": "orthotropy",
    "droop_by_flow": "supply_droop",
}


@effect("environment", x=(0.0, "Pa"), y=(0.0, "Pa"), z=(0.4, "Pa"), gust=(0.5, "1"), frequency=(0.7, "Hz"))
def wind(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """A draught's pressure along (x, y, z) on the cloth's normal, with a sinusoidal gust."""
    direction = np.array([values[a] for a in "xyz"])

    def blow(time: float, n: Array, v: Array) -> Array:
        gust = 1.0 + values["gust"] * np.sin(2 * np.pi * values["frequency"] * time)
        return np.asarray(gust * (n @ direction))

    load_along_normals(scene, blow)


@effect("environment", u=(0.1, "m"), v=(0.2, "m"), x=(0.0, "m"), y=(-0.2, "m"), z=(0.05, "m"), stiffness=(0.3, "N/m"))
def spring(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """A spring of no length from (u, v) of the cloth to the fixed point (x, y, z)."""
    scene.ties = sp.vstack([scene.ties, scene.patch.matrix(np.array([[values["u"], values["v"]]]))]).tocsr()
    scene.tie_stiffness = np.append(scene.tie_stiffness, values["stiffness"])
    scene.tied_to = np.vstack([scene.tied_to, [values[a] for a in "xyz"]])


@effect("fabric", v=(0.1, "m"), width=(0.02, "m"), factor=(6.0, "1"), curvature=(4.0, "1/m"))
def seam_snap(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """A stiff seam across the cloth at v; it snaps for the rest of the trial where it is bent too much."""
    share = _within(scene.uv[:, 1], values["v"] - values["width"] / 2, values["v"] + values["width"] / 2)
    stiffer = 1.0 + (values["factor"] - 1.0) * share[:, None]
    scene.stiffness *= stiffer
    intact = [True]

    def snap(scene: Scene, report: StepReport) -> None:
        if intact[0] and np.abs(report.strain[share > 0, 4]).max(initial=0.0) > values["curvature"]:
            scene.stiffness /= stiffer
            intact[0] = False

    scene.after_step.append(snap)


def _within(s: Array, low: float, high: float) -> Array:
    """Return (q,) how much of the stretch that each s stands for, up to halfway to its neighbours, lies from low to
    high."""
    middle = np.unique(s)
    ends = np.concatenate([middle[:1], (middle[1:] + middle[:-1]) / 2, middle[-1:]])
    share = np.diff(np.clip(ends, low, high)) / np.diff(ends)
    return np.asarray(share[np.searchsorted(middle, s)])


@effect("muscle", loss=(0.3, "1"), time=(1.0, "s"), each_trial=(0.0, "s"))
def heating(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Muscles lose `loss` of their gain with use: full pressure warms them with the time constant `time`. Each trial
    before counts as `each_trial` of it."""
    cold = scene.muscle_state.gain.copy()
    use = np.full(len(cold), order * values["each_trial"])

    def warm(scene: Scene, report: StepReport) -> None:
        use[:] += report.step * report.pressure / FULL_PRESSURE
        scene.muscle_state.gain = cold * (1.0 - values["loss"] * -np.expm1(-use / values["time"]))

    scene.after_step.append(warm)


@effect("interface", channel=(0.0, "1"), give=(0.3, "1"), trials=(3.0, "1"))
def loosening(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """The loops of one channel's muscles give from trial to trial: their axes lie farther off the cloth, by the share
    `give` in the end."""
    cables, share = scene.cables, values["give"] * -np.expm1(-order / values["trials"])
    upper = cables.first[scene.channel == int(values["channel"])]
    cables.offset[np.union1d(upper, upper + 1)] *= 1.0 + share


@effect("pneumatics", full=(350.0, "kPa"), sink=(50.0, "kPa"))
def sinking_supply(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """No channel gets more than the supply has: `full`, less `sink` for each trial before."""
    supply = max(from_kpa(values["full"] - order * values["sink"]), 0.0)
    scene.pressure_hooks.append(lambda pressure, step: np.minimum(pressure, supply))


@pressure_effect(share=(0.15, "1"))
def crosstalk(pressure: Array, step: float, values: Mapping[str, float]) -> Array:
    """Return pressures of leaking valves: every channel also gets `share` of that of the one before it."""
    return np.asarray(pressure + values["share"] * np.roll(pressure, 1, axis=1))


@pressure_effect(line=(0.06, "s"), muscle=(0.06, "s"))
def lag_of_two_volumes(pressure: Array, step: float, values: Mapping[str, float]) -> Array:
    """Two first-order lags in a row, line and muscle: a filling lag of the second order."""
    out = pressure
    for time in (values["line"], values["muscle"]):
        wanted, out = out, np.zeros_like(out)
        for k in range(1, len(out)):
            out[k] = out[k - 1] - np.expm1(-step / time) * (wanted[k] - out[k - 1])
    return out


@effect("muscle", share=(0.3, "1"), quick=(0.2, "s"), slow=(1.5, "s"))
def creep_of_two_times(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Muscle creep by two slow states, a quick and a slow one, with half of the share each."""
    states = [np.zeros(len(scene.cables.rest)) for _ in range(2)]

    def creep(scene: Scene, report: StepReport) -> None:
        goal = 0.5 * values["share"] * np.maximum(report.contraction, 0.0)
        for state, time in zip(states, (values["quick"], values["slow"]), strict=True):
            state += (goal - state) * -np.expm1(-report.step / time)
        scene.muscle_state.creep = states[0] + states[1]

    scene.after_step.append(creep)


@effect("fabric", ratio=(3.0, "1"))
def orthotropy_of_bending(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """B_1 / B_2 times `ratio`, their product and the membrane unchanged."""
    root = values["ratio"] ** 0.5
    scene.stiffness[:, 4] *= root
    scene.stiffness[:, 6] /= root


@pressure_effect(share=(0.15, "1"))
def droop_by_flow(pressure: Array, step: float, values: Mapping[str, float]) -> Array:
    """Other channels take of a channel's pressure by its own pressure, `share` at 400 kPa."""
    others = (pressure.sum(axis=1, keepdims=True) - pressure) / FULL_PRESSURE
    return np.asarray(pressure * np.maximum(1.0 - values["share"] * others, 0.0))
