"""A virtual rig: an implicit finite-element shell of its own, with laced cables and point sensors (docs/rig.md)."""

from studies.rig.run import RigSession, run_rig
from studies.rig.scene import DEFAULT
from studies.rig.specimen import EffectSetting, GroundTruth, Sensing, read_ground_truth

__all__ = ["DEFAULT", "EffectSetting", "GroundTruth", "RigSession", "Sensing", "read_ground_truth", "run_rig"]
