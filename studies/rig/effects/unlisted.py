"""Effects that no list of known ones has (* in docs/rig.md): an honest trace leaves them unexplained."""

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from studies.rig.effects.declaration import RigEffect
from studies.rig.effects.environment import normals
from studies.rig.scene import Scene, StepReport

Array = NDArray[np.float64]
FULL_PRESSURE = 4e5  # Pa, at which a muscle warms at its full rate


def wind(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """A draught's pressure along (x, y, z) on the cloth's normal, with a sinusoidal gust."""
    value, along_u, along_v = (scene.patch.matrix(scene.uv, *d) for d in ((0, 0), (1, 0), (0, 1)))
    direction = np.array([values[a] for a in "xyz"])

    def blow(time: float, x: Array, v: Array) -> Array:
        gust = 1.0 + values["gust"] * np.sin(2 * np.pi * values["frequency"] * time)
        n = normals(scene, x, along_u, along_v)
        pressure = gust * (n @ direction) * scene.weight
        return np.asarray(value.T @ (pressure[:, None] * n))

    scene.loads.append(blow)


def spring(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """A spring of no length from (u, v) of the cloth to the fixed point (x, y, z)."""
    scene.ties = sp.vstack([scene.ties, scene.patch.matrix(np.array([[values["u"], values["v"]]]))]).tocsr()
    scene.tie_stiffness = np.append(scene.tie_stiffness, values["stiffness"])
    scene.tied_to = np.vstack([scene.tied_to, [values[a] for a in "xyz"]])


def seam_snap(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """A stiff seam across the cloth at v; it snaps for the rest of the trial where it is bent too much."""
    share = _within(scene.uv[:, 1], values["v"] - values["width"] / 2, values["v"] + values["width"] / 2)
    stiffer = 1.0 + (values["factor"] - 1.0) * share[:, None]
    scene.stiffness *= stiffer
    whole = [True]

    def snap(scene: Scene, report: StepReport) -> None:
        if whole[0] and np.abs(report.strain[share > 0, 4]).max(initial=0.0) > values["curvature"]:
            scene.stiffness /= stiffer
            whole[0] = False

    scene.after_step.append(snap)


def _within(s: Array, low: float, high: float) -> Array:
    """Return (q,) how much of the stretch that each s stands for, up to halfway to its neighbours, lies from low to
    high."""
    middle = np.unique(s)
    ends = np.concatenate([middle[:1], (middle[1:] + middle[:-1]) / 2, middle[-1:]])
    share = np.diff(np.clip(ends, low, high)) / np.diff(ends)
    return np.asarray(share[np.searchsorted(middle, s)])


def heating(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Muscles lose `loss` of their gain with use: full pressure warms them with the time constant `time`."""
    cold = scene.muscle_state.gain.copy()
    use = np.zeros(len(cold))

    def warm(scene: Scene, report: StepReport) -> None:
        use[:] += report.step * report.pressure / FULL_PRESSURE
        scene.muscle_state.gain = cold * (1.0 - values["loss"] * -np.expm1(-use / values["time"]))

    scene.after_step.append(warm)


def crosstalk(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """A leaking valve: every channel also gets `share` of its neighbour's pressure (the one before it)."""

    def leak(pressure: Array, step: float) -> Array:
        return np.asarray(pressure + values["share"] * np.roll(pressure, 1, axis=1))

    scene.pressure_hooks.append(leak)


EFFECTS = {
    "wind": RigEffect(
        "environment",
        {"x": (0.0, "Pa"), "y": (0.0, "Pa"), "z": (0.4, "Pa"), "gust": (0.5, "1"), "frequency": (0.7, "Hz")},
        wind,
    ),
    "spring": RigEffect(
        "environment",
        {
            "u": (0.1, "m"), "v": (0.2, "m"), "x": (0.0, "m"), "y": (-0.2, "m"), "z": (0.05, "m"),
            "stiffness": (0.3, "N/m"),
        },
        spring,
    ),
    "seam_snap": RigEffect(
        "fabric",
        {"v": (0.1, "m"), "width": (0.02, "m"), "factor": (6.0, "1"), "curvature": (4.0, "1/m")},
        seam_snap,
    ),
    "heating": RigEffect("muscle", {"loss": (0.3, "1"), "time": (1.0, "s")}, heating),
    "crosstalk": RigEffect("pneumatics", {"share": (0.15, "1")}, crosstalk),
}  # fmt: skip
