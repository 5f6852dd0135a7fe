"""`[rig_limits]` of a study: what the laboratory can do."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fabdesign.effort import LONGEST
from fabdesign.table import Table
from fabdesign.units import from_kpa, in_kpa

HIGHEST = 300e3  # Pa, of programs that nobody named, where the muscles allow it


@dataclass(frozen=True)
class RigLimits:
    """SI."""

    pressure: float = HIGHEST  # Pa
    rate: float = np.inf  # Pa/s
    duration: float = 3.0  # s, of a program
    channels: int | None = None


USUAL_LIMITS = RigLimits()


def read_rig_limits(root: Table, path: Path, *, pressure: float = HIGHEST, duration: float = 3.0) -> RigLimits:
    """Of the study or set at `path`, whose table may leave all of it out; then `pressure` [Pa] and `duration` [s] hold.
    Raises InputError."""
    table = root.table("rig_limits", None) or Table({}, f"{path}: rig_limits")
    given = table.take("pressure", None)
    if isinstance(given, list):  # [lowest, highest], as in [limits]
        highest = table.numbers("pressure", count=2)[1]
    else:
        highest = table.number("pressure", in_kpa(pressure), above=0)
    limits = RigLimits(
        pressure=from_kpa(highest),
        rate=from_kpa(table.number("rate", np.inf, above=0)),
        duration=table.number("duration", duration, above=0, most=LONGEST),
        channels=table.integer("channels", None, least=1),
    )
    table.finish()
    return limits
