"""An effect of the virtual rig: a change to a scene before it runs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from studies.rig.scene import Scene

Apply = Callable[[Scene, int, Mapping[str, float]], None]
EFFECTS: dict[str, "RigEffect"] = {}


@dataclass(frozen=True)
class RigEffect:
    """`apply(scene, order, values)` edits the scene; order is the trial's place in the specimen's session."""

    site: str
    parameters: Mapping[str, tuple[float, str]]  # name -> default, unit
    apply: Apply


def effect(site: str, **parameters: tuple[float, str]) -> Callable[[Apply], Apply]:
    """Declare a function as the effect of its name."""

    def declared(apply: Apply) -> Apply:
        EFFECTS[apply.__name__] = RigEffect(site, parameters, apply)
        return apply

    return declared
