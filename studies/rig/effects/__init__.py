"""Effects of the virtual rig by name: the table of docs/rig.md."""

from studies.rig.effects import listed, unlisted
from studies.rig.scene import EFFECTS, RigEffect

LISTED: dict[str, RigEffect] = {name: one for name, one in EFFECTS.items() if one.apply.__module__ == listed.__name__}
__all__ = ["EFFECTS", "LISTED", "RigEffect", "unlisted"]
