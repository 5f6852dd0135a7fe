"""Effects of the virtual rig by name: the table of docs/rig.md."""

from studies.rig.effects import environment, fabric, interface, muscle, pneumatics, sensing, unlisted, variants
from studies.rig.effects.declaration import Effect

LISTED: dict[str, Effect] = (
    muscle.EFFECTS | pneumatics.EFFECTS | fabric.EFFECTS | interface.EFFECTS | environment.EFFECTS | sensing.EFFECTS
)
EFFECTS: dict[str, Effect] = LISTED | unlisted.EFFECTS | variants.EFFECTS
