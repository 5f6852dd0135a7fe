"""The kernels' parts of effects: added forces, a file each (their declarations are in fabdesign/effects)."""

from sim.effects import (
    air_drag,
    braid_hysteresis,
    learned,
    muscle_creep,
    muscle_viscosity,
    threshold_pressure,
)  # fmt: skip

__all__ = [
    "air_drag", "braid_hysteresis", "learned", "muscle_creep", "muscle_viscosity", "threshold_pressure",
]  # fmt: skip
