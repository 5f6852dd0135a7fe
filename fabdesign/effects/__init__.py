"""Effects: what a quasi-static model of cloth and muscles lacks, declared (docs/effects.md). Belongs here: a
declaration, what acts before and after the kernels; forces with memory are in `sim.effects`."""

from fabdesign.effects.declaration import ActingPressure, Effect, EffectParameter, MuscleRecord, Specimen
from fabdesign.effects.registry import BUILT_IN, EFFECTS, register, register_file

__all__ = [
    "BUILT_IN", "EFFECTS", "ActingPressure", "Effect", "EffectParameter", "MuscleRecord", "Specimen", "register",
    "register_file",
]  # fmt: skip
