"""Listed effects in another form than the simulator's: the same cause by another law, as a laboratory would have it.

Whoever looks for causes should name the listed effect, with the parameters nearest to it (docs/rig.md).
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from studies.rig.effects.declaration import RigEffect
from studies.rig.scene import Scene, StepReport

Array = NDArray[np.float64]
FULL_PRESSURE = 4e5  # Pa, at which a channel draws its whole share


def lag_of_two_volumes(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Two first-order lags in a row, line and muscle: a filling lag of the second order."""

    def lag(pressure: Array, step: float) -> Array:
        out = pressure
        for time in (values["line"], values["muscle"]):
            wanted, out = out, np.zeros_like(out)
            for k in range(1, len(out)):
                out[k] = out[k - 1] - np.expm1(-step / time) * (wanted[k] - out[k - 1])
        return out

    scene.pressure_hooks.append(lag)


def creep_of_two_times(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Muscle creep by two slow states, a quick and a slow one, with half of the share each."""
    states = [np.zeros(len(scene.cables.rest)) for _ in range(2)]

    def creep(scene: Scene, report: StepReport) -> None:
        goal = 0.5 * values["share"] * np.maximum(report.contraction, 0.0)
        for state, time in zip(states, (values["quick"], values["slow"]), strict=True):
            state += (goal - state) * -np.expm1(-report.step / time)
        scene.muscle_state.creep = states[0] + states[1]

    scene.after_step.append(creep)


def orthotropy_of_bending(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """B_1 / B_2 times `ratio`, their product and the membrane unchanged."""
    root = values["ratio"] ** 0.5
    scene.stiffness[:, 4] *= root
    scene.stiffness[:, 6] /= root


def droop_by_flow(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Other channels take of a channel's pressure by its own pressure, `share` at 400 kPa."""

    def droop(pressure: Array, step: float) -> Array:
        others = (pressure.sum(axis=1, keepdims=True) - pressure) / FULL_PRESSURE
        return np.asarray(pressure * np.maximum(1.0 - values["share"] * others, 0.0))

    scene.pressure_hooks.append(droop)


# name -> the effect, whose cause is that of the listed one named beside it
OF = {
    "lag_of_two_volumes": "filling_lag",
    "creep_of_two_times": "muscle_creep",
    "orthotropy_of_bending": "orthotropy",
    "droop_by_flow": "supply_droop",
}
EFFECTS = {
    "lag_of_two_volumes": RigEffect("pneumatics", {"line": (0.06, "s"), "muscle": (0.06, "s")}, lag_of_two_volumes),
    "creep_of_two_times": RigEffect(
        "muscle", {"share": (0.3, "1"), "quick": (0.2, "s"), "slow": (1.5, "s")}, creep_of_two_times
    ),
    "orthotropy_of_bending": RigEffect("fabric", {"ratio": (3.0, "1")}, orthotropy_of_bending),
    "droop_by_flow": RigEffect("pneumatics", {"share": (0.15, "1")}, droop_by_flow),
}
