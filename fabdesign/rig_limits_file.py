"""`[rig_limits]` of a study: what the laboratory can do."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from fabdesign.decoder import as_number
from fabdesign.effort import LONGEST
from fabdesign.schema import ABOVE_0, Key, Kilopascal, KilopascalPerSecond, Second, Within
from fabdesign.table import Table
from fabdesign.units import from_kpa

HIGHEST = 300e3  # Pa, of programs that nobody named, where the muscles allow it


def _highest(value: Any, table: Table) -> float | None:
    """Return Pa of a number in kPa, or of [lowest, highest] as in [limits]."""
    if isinstance(value, list | tuple) and len(value) == 2:
        return None if as_number(value[0]) is None else _highest(value[1], table)
    number = as_number(value)
    return from_kpa(number) if number is not None and 0 < number < np.inf else None


@dataclass(frozen=True)
class RigLimits:
    """What next experiments keep."""

    pressure: Annotated[  # Pa
        Kilopascal, Key(read=_highest, expected="a number above 0"), "of programs that the study does not name"
    ] = HIGHEST
    rate: Annotated[KilopascalPerSecond, ABOVE_0, "of a set point; absent: steps are possible"] = np.inf  # Pa/s
    duration: Annotated[Second, Within(above=0, most=LONGEST), "of a program"] = 3.0
    channels: Annotated[int | None, Within(least=1), "of pressure; absent: any"] = None


USUAL_LIMITS = RigLimits()
