"""Effects of the virtual rig by name: the table of formats.md, and some that are not in it."""

from studies.rig.effects.declaration import Effect

EFFECTS: dict[str, Effect] = {}
