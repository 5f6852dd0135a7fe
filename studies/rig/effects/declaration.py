"""An effect of the virtual rig: a change to a scene before it runs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from studies.rig.scene import Scene


@dataclass(frozen=True)
class RigEffect:
    """`apply(scene, order, values)` edits the scene; order is the trial's place in the specimen's session."""

    site: str
    parameters: Mapping[str, tuple[float, str]]  # name -> default, unit
    apply: Callable[[Scene, int, Mapping[str, float]], None]
