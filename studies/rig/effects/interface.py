"""Between muscle and cloth."""

from collections.abc import Mapping

import numpy as np

from studies.rig.effects.declaration import RigEffect
from studies.rig.scene import Scene, StepReport

SLIP_DAMPING = 6.0  # of the muscle's viscosity over interval length; under 3 a step overshoots
LEAST_VISCOSITY = 2.0  # N s


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


EFFECTS = {"loop_slip": RigEffect("interface", {"friction": (0.02, "1"), "grip": (0.02, "N")}, loop_slip)}
