"""Effects: what a quasi-static model of cloth and muscles lacks, declared (docs/effects.md). Belongs here: a
declaration, what acts before and after the kernels; forces with memory are in `sim.effects`."""

from fabdesign.effects.bench import MuscleRecord
from fabdesign.effects.declaration import Effect, EffectParameter
from fabdesign.effects.pressures import ActingPressure
from fabdesign.effects.registry import BUILT_IN, EFFECTS, register, register_file
from fabdesign.effects.specimen import Specimen

__all__ = [
    "BUILT_IN", "EFFECTS", "ActingPressure", "Effect", "EffectParameter", "MuscleRecord", "Specimen", "register",
    "register_file",
]  # fmt: skip
