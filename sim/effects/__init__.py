"""The kernels' parts of effects: added forces, a file each (their declarations are in fabdesign/effects)."""

from sim.effects import air_drag, braid_hysteresis, muscle_creep

__all__ = ["air_drag", "braid_hysteresis", "muscle_creep"]
