"""A design: one cloth with its muscles."""

from collections.abc import Mapping
from dataclasses import dataclass

from fabdesign.fabric import Fabric
from fabdesign.muscle import Muscle, MuscleType


@dataclass(frozen=True)
class Design:
    name: str
    fabric: Fabric
    muscle_types: Mapping[str, MuscleType]
    muscles: tuple[Muscle, ...]

    @property
    def channels(self) -> int:
        """Number of pressure channels: the highest channel in use, plus one."""
        return max((m.channel for m in self.muscles), default=-1) + 1
