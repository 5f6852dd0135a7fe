"""How a cloth is held."""

from fabdesign.fabric import Fabric

HUNG = {"top": 0, "bottom": 1, "left": 2, "right": 3, "none": 4}
FREE = HUNG["none"]  # also: held at points


def hung_code(fabric: Fabric) -> int:
    """Of HUNG; held at points is free to the preconditioner."""
    return HUNG[fabric.hung] if isinstance(fabric.hung, str) else FREE
