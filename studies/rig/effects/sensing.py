"""Effects in what the sensors say."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from studies.rig.effects.declaration import RigEffect
from studies.rig.scene import Scene

Array = NDArray[np.float64]


def registration_bias(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Clouds are turned about the world's axes and shifted, always alike."""
    turn = Rotation.from_euler("xyz", [values[f"about_{a}"] for a in "xyz"], degrees=True).as_matrix()
    shift = np.array([values[a] for a in "xyz"])
    scene.sensed.append(lambda points: points @ turn.T + shift)


def time_offset(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """A frame shows the cloth as it was `offset` before the frame's time."""
    scene.time_shift -= values["offset"]


def scale_error(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Coordinates are too large by `scale`, from the origin."""
    scene.sensed.append(lambda points: points * (1.0 + values["scale"]))


OF_CLOUDS = ("registration_bias", "scale_error")  # they change what is seen of a motion, never the motion
EFFECTS = {
    "registration_bias": RigEffect(
        "sensing",
        {
            **{a: (0.003 if a == "z" else 0.0, "m") for a in "xyz"},
            **{f"about_{a}": (0.0, "deg") for a in "xyz"},
        },
        registration_bias,
    ),
    "time_offset": RigEffect("sensing", {"offset": (0.05, "s")}, time_offset),
    "scale_error": RigEffect("sensing", {"scale": (0.02, "1")}, scale_error),
}
