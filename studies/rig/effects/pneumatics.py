"""Effects between the regulator's set point and the pressure in a muscle."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from studies.rig.effects.declaration import RigEffect
from studies.rig.scene import Scene

Array = NDArray[np.float64]
OPEN = 5e3  # Pa, above which a channel draws from the supply


def filling_lag(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """dp/dt = (set point - p) / tau, with a time constant each for filling and emptying."""

    def lag(pressure: Array, step: float) -> Array:
        fill, empty = (-np.expm1(-step / values[k]) for k in ("fill", "empty"))
        out = pressure.copy()
        out[0] = 0.0
        for k in range(1, len(out)):
            gap = pressure[k] - out[k - 1]
            out[k] = out[k - 1] + gap * np.where(gap > 0, fill, empty)
        return out

    scene.pressure_hooks.append(lag)


def dead_time(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """p(t - delay); zero before."""

    def delay(pressure: Array, step: float) -> Array:
        time = np.arange(len(pressure)) * step
        ends = np.searchsorted(time, time - values["delay"] - 1e-9)  # the step in which the earlier instant lies
        return np.asarray(np.where((time > values["delay"] + 1e-9)[:, None], pressure[ends], 0.0))

    scene.pressure_hooks.append(delay)


def supply_droop(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Other open channels take a share of a channel's pressure."""

    def droop(pressure: Array, step: float) -> Array:
        is_open = pressure > OPEN
        others = is_open.sum(axis=1, keepdims=True) - is_open
        return np.asarray(pressure * np.maximum(1.0 - values["share"] * others, 0.0))

    scene.pressure_hooks.append(droop)


def line_loss(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Pressure falls linearly along a muscle, from its path's first point to its last."""
    scene.muscle_state.pressure_factor *= 1.0 - values["share"] * scene.cables.along


EFFECTS = {
    "filling_lag": RigEffect("pneumatics", {"fill": (0.08, "s"), "empty": (0.16, "s")}, filling_lag),
    "dead_time": RigEffect("pneumatics", {"delay": (0.04, "s")}, dead_time),
    "supply_droop": RigEffect("pneumatics", {"share": (0.05, "1")}, supply_droop),
    "line_loss": RigEffect("pneumatics", {"share": (0.3, "1")}, line_loss),
}
