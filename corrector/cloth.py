"""The one cloth of a training."""

from dataclasses import dataclass

from fabdesign.fabric import Fabric


@dataclass(frozen=True)
class Cloth:
    """What all examples of a training have in common."""

    fabric: Fabric  # its size and support
    ratio: float  # response.weight_over_stiffness
