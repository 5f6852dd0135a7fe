"""`[rig_limits]` of a study: what the laboratory can do."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from fabdesign.formats.schema import ABOVE_0, Key, Kilopascal, KilopascalPerSecond, Second, Within
from fabdesign.formats.table import Table
from fabdesign.runtime.effort import LONGEST

HIGHEST = 300e3  # Pa, of programs that nobody named, where the muscles allow it


def _highest(value: float | tuple[float, float], table: Table) -> float:
    """Return Pa of one number, or of [lowest, highest] as in [limits]."""
    return value[1] if isinstance(value, tuple) else value


_Highest = Annotated[Kilopascal, ABOVE_0] | tuple[Kilopascal, Kilopascal]


@dataclass(frozen=True)
class RigLimits:
    """The limits that next experiments keep."""

    pressure: Annotated[Kilopascal, Key(form=_Highest, read=_highest), "of programs that nobody named"] = HIGHEST
    rate: Annotated[KilopascalPerSecond, ABOVE_0, "of a set point; absent: steps are possible"] = np.inf  # Pa/s
    duration: Annotated[Second, Within(above=0, most=LONGEST), "of a program"] = 3.0
    channels: Annotated[int | None, Within(least=1), "of pressure; absent: any"] = None
    cycle: Annotated[Second, Within(least=0.005, most=1), "of the regulator: a set point holds for so long"] = 0.05
    resolution: Annotated[Kilopascal, Within(least=0.001, most=100), "of a set point"] = 100.0  # Pa
    delay: Annotated[Second, Within(least=0, most=1), "from a set point to the valve"] = 0.0
    supply: Annotated[Kilopascal | None, ABOVE_0, "pressure before the regulator; absent: enough"] = None  # Pa


USUAL_LIMITS = RigLimits()
