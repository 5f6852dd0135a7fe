"""Effects in the cloth, and between muscle and cloth."""

from collections.abc import Mapping

import numpy as np

from studies.rig.effects.declaration import RigEffect
from studies.rig.scene import Scene, StepReport

PATCH_EDGE = 0.004  # m, over which a stiff patch fades out
SLIP_DAMPING = 6.0  # of the muscle's viscosity over interval length; under 3 a step overshoots
LEAST_VISCOSITY = 2.0  # N s


def orthotropy(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """k_1 / k_2 and B_1 / B_2 times `ratio`, their products unchanged."""
    root = values["ratio"] ** 0.5
    scene.stiffness[:, [0, 4]] *= root
    scene.stiffness[:, [2, 6]] /= root


def local_stiffening(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Membrane and bending times `factor` in a disc."""
    distance = np.hypot(scene.uv[:, 0] - values["u"], scene.uv[:, 1] - values["v"])
    inside = 1.0 / (1.0 + np.exp((distance - values["radius"]) / (PATCH_EDGE / 4)))
    scene.stiffness *= (1.0 + (values["factor"] - 1.0) * inside)[:, None]


def stress_relaxation(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """One Prony term: `share` of the cloth's stress relaxes; declared values are the instantaneous ones."""
    scene.prony, scene.prony_time = values["share"], values["time"]


def rest_curvature(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """The free cloth is curved; positive curvature bends the hem towards the viewer."""
    scene.rest_strain[:, 3] += values["across"]
    scene.rest_strain[:, 4] += values["down"]
    scene.rest_strain[:, 5] += values["twist"]


def loop_slip(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Muscle slides through a fixed point where tensions differ by more than friction times their mean."""
    cables = scene.cables
    upper = np.flatnonzero(np.diff(cables.muscle) == 0)
    lower = upper + 1

    def slip(scene: Scene, report: StepReport) -> None:
        difference = report.tension[lower] - report.tension[upper]
        held = values["friction"] * (np.abs(report.tension[lower]) + np.abs(report.tension[upper])) / 2
        excess = np.sign(difference) * np.maximum(np.abs(difference) - held - values["grip"], 0.0)
        viscosity = np.maximum(scene.muscle_state.viscosity[upper], LEAST_VISCOSITY)
        moved = report.step * excess * cables.rest[upper] / (SLIP_DAMPING * viscosity)
        np.add.at(cables.rest, lower, moved)  # material goes where the tension is higher
        np.add.at(cables.rest, upper, -moved)

    scene.after_step.append(slip)


EFFECTS = {
    "orthotropy": RigEffect("fabric", {"ratio": (2.0, "1")}, orthotropy),
    "local_stiffening": RigEffect(
        "fabric",
        {"u": (0.1, "m"), "v": (0.1, "m"), "radius": (0.03, "m"), "factor": (4.0, "1")},
        local_stiffening,
    ),
    "stress_relaxation": RigEffect("fabric", {"share": (0.3, "1"), "time": (0.7, "s")}, stress_relaxation),
    "rest_curvature": RigEffect(
        "fabric",
        {"across": (0.0, "1/m"), "down": (1.5, "1/m"), "twist": (0.0, "1/m")},
        rest_curvature,
    ),
    "loop_slip": RigEffect("interface", {"friction": (0.02, "1"), "grip": (0.02, "N")}, loop_slip),
}
