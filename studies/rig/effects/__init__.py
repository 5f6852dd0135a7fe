"""Effects of the virtual rig by name: the table of docs/rig.md."""

from studies.rig.effects import environment, fabric, muscle, pneumatics, sensing, unlisted, variants
from studies.rig.effects.declaration import RigEffect

LISTED: dict[str, RigEffect] = (
    muscle.EFFECTS | pneumatics.EFFECTS | fabric.EFFECTS | environment.EFFECTS | sensing.EFFECTS
)
EFFECTS: dict[str, RigEffect] = LISTED | unlisted.EFFECTS | variants.EFFECTS
