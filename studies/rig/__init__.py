"""A virtual rig: an implicit finite-element shell of its own, with laced cables and point sensors (docs/rig.md)."""

from studies.rig.key import EffectSetting, Key, Sensing, read_key
from studies.rig.run import run_rig

__all__ = ["EffectSetting", "Key", "Sensing", "read_key", "run_rig"]
