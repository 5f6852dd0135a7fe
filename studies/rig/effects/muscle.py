"""Effects in the muscles themselves."""

from collections.abc import Mapping

import numpy as np

from fabdesign.errors import InputError
from fabdesign.units import from_kpa
from studies.rig.effects.declaration import RigEffect
from studies.rig.scene import Scene, StepReport


def threshold_pressure(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """p acts as softplus(p - threshold)."""
    scene.muscle_state.threshold = from_kpa(values["threshold"])
    scene.muscle_state.threshold_width = from_kpa(values["width"])


def braid_hysteresis(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Coulomb friction that grows with pressure: one Maxwell-slip element an interval."""
    scene.muscle_state.friction_per_pressure = values["friction"] / from_kpa(1.0)  # N/Pa
    scene.muscle_state.friction_at_zero = values["friction_at_zero"]
    scene.muscle_state.friction_slip = values["slip"]


def muscle_creep(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Standard linear solid: part of the contraction is lent by a slow state that the bench law does not see."""

    def creep(scene: Scene, report: StepReport) -> None:
        state = scene.muscle_state
        goal = values["share"] * np.maximum(report.contraction, 0.0)
        state.creep += (goal - state.creep) * -np.expm1(-report.step / values["time"])

    scene.after_step.append(creep)


def muscle_viscosity(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Viscosity beyond the declared one, different while contracting and while lengthening."""
    scene.muscle_state.viscosity += values["contracting"]
    scene.muscle_state.viscosity_out += values["lengthening"]


def stroke_softening(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """The active tension falls from trial to trial, by `loss` in the end."""
    scene.muscle_state.gain *= 1.0 - values["loss"] * -np.expm1(-order / values["trials"])


def odd_muscle(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """One channel's muscles pull with another gain."""
    channel = int(values["channel"])
    if channel not in scene.channel:
        raise InputError(f"odd_muscle: channel {channel} has no muscle in design {scene.design.name}")
    scene.muscle_state.gain[scene.channel == channel] *= values["factor"]


EFFECTS = {
    "threshold_pressure": RigEffect("muscle", {"threshold": (40.0, "kPa"), "width": (10.0, "kPa")}, threshold_pressure),
    "braid_hysteresis": RigEffect(
        "muscle",
        {"friction": (0.005, "N/kPa"), "friction_at_zero": (0.0, "N"), "slip": (0.005, "1")},
        braid_hysteresis,
    ),
    "muscle_creep": RigEffect("muscle", {"share": (0.15, "1"), "time": (0.8, "s")}, muscle_creep),
    "muscle_viscosity": RigEffect(
        "muscle", {"contracting": (20.0, "N s"), "lengthening": (10.0, "N s")}, muscle_viscosity
    ),
    "stroke_softening": RigEffect("muscle", {"loss": (0.15, "1"), "trials": (3.0, "1")}, stroke_softening),
    "odd_muscle": RigEffect("muscle", {"channel": (0.0, "1"), "factor": (0.8, "1")}, odd_muscle),
}
