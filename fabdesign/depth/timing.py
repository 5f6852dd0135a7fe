"""What was found of a recording's clocks: stands in the set that it was fused into."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from fabdesign.formats.schema import FROM_0, FileUnit, Key, Second

_PPM = FileUnit("ppm", lambda number: 1e-6 * float(number), lambda number: round(1e6 * number, 2))


@dataclass(frozen=True)
class SensorTiming:
    """One camera's clock against the first camera's, and what became of its images."""

    offset: Annotated[Second, "by which its clock is ahead of the first camera's, in the recording's middle"] = 0.0
    drift: Annotated[float, _PPM, Key("drift_ppm"), "by which its clock runs fast against the first camera's"] = 0.0
    known: Annotated[Second, "standard deviation of the offset by noise alone; the motion's form adds 1 ms or so"] = 0.0
    estimated: Annotated[bool, "from the motion; else as the stamps say"] = True
    images: Annotated[int, FROM_0, "in the file"] = 0
    lost: Annotated[int, FROM_0, "that the stamps or the counter miss"] = 0
    repeated: Annotated[int, FROM_0, "left out since they repeat the one before"] = 0
    late: Annotated[int, FROM_0, "over a quarter of an interval off their place"] = 0
    unpaired: Annotated[int, FROM_0, "in no frame of the set"] = 0


@dataclass(frozen=True)
class RecordingTiming:
    """The clocks of one recording."""

    interval: Annotated[Second, "between frames"] = 0.0
    left_out: Annotated[int, FROM_0, "frames that a side has no image for"] = 0
    pressure: Annotated[Second, Key("pressure_offset"), "of the log's 0 after the first camera's first image"] = 0.0
    pressure_known: Annotated[Second, "standard deviation over cameras and steps"] = 0.0
    steps: Annotated[int, FROM_0, "of the pressure that say it; 0: it is as given"] = 0
    sensors: Annotated[Mapping[str, SensorTiming], "by name"] = field(default_factory=dict)
