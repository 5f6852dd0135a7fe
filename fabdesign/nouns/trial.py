"""Trials: one measured motion each, and the sets they come in."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np
from numpy.typing import NDArray

from fabdesign.files.design_file import read_design
from fabdesign.files.trial_file import TrialData, program_of, read_trial, read_trial_pressures
from fabdesign.formats.schema import ABOVE_0, FROM_0, FileUnit, Key, Second, Within
from fabdesign.formats.table import Table, nearest
from fabdesign.geometry.hung_cloth import require_on_cloth
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import USUAL_LIMITS, PressureProgram, RigLimits, require_pressures

Role = Literal["fit", "test"]
LEAST_TRIALS = 3  # with different pressures, or records of a bench: each is predicted from the others


def _design_of(table: Table) -> Design:
    name, designs = table.decoded["design_name"], table.find("designs")
    if name not in designs:
        raise table.bad("design", f"one of [designs], {', '.join(designs)}{nearest(name, [*designs])}")
    return cast(Design, designs[name])


@dataclass(frozen=True)
class Trial:
    """One motion of a set. Its file is opened when its content is asked for; that raises InputError."""

    file: Annotated[Path, Key(there=Path.is_file), "the npz"]
    design_name: Annotated[str, Key("design"), "one of [designs]"]
    design: Annotated[Design, Key("", absent=_design_of)]
    order: Annotated[int, "place in the specimen's session, for what builds up from trial to trial"]
    role: Annotated[Role, "nothing may be fitted or chosen on test"]
    _sound: list[bool] = field(default_factory=list, init=False, repr=False, compare=False)  # filled once it is

    @property
    def name(self) -> str:
        return self.file.stem

    @cached_property
    def times(self) -> NDArray[np.float64]:
        """Return (T,) s after rest."""
        return read_trial_pressures(self.file)[0]

    @cached_property
    def program(self) -> PressureProgram:
        """Return the set points, checked against the design's channels and the muscles' limits."""
        program = program_of(*read_trial_pressures(self.file))
        require_pressures(program, self.design, str(self.file))
        return program

    def load(self) -> TrialData:
        """Return all arrays, checked, the first time also against the design: its channels, its limits, where its cloth
        can be. The clouds are not kept by the trial."""
        data = read_trial(self.file, size=max(self.design.fabric.width, self.design.fabric.height))
        if not self._sound:
            require_pressures(data.program, self.design, str(self.file))
            require_on_cloth(data.frames, data.time, self.design.fabric, str(self.file))
            self._sound.append(True)
        return data


@dataclass(frozen=True)
class Accuracy:
    """Standard deviations of what the trials were given. By default those of a laboratory that says nothing of them."""

    pressure: Annotated[float, Within(least=0, most=1), "of a channel, as a share of it; with tilt_deg 0: exact"] = 0.01
    tilt: Annotated[float, Key("tilt_deg"), FileUnit("degrees"), Within(least=0, most=45), "of the level"] = 0.5

    @staticmethod
    def worst(accuracies: "Sequence[Accuracy]") -> "Accuracy":
        return Accuracy(max(one.pressure for one in accuracies), max(one.tilt for one in accuracies))


USUAL = Accuracy()
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


@dataclass(frozen=True)
class MeasurementSet:
    """Motions measured on one specimen or more."""

    name: Annotated[str, Key(absent=lambda table: table.file.resolve().parent.name), "by default the folder's"]
    designs: Annotated[Mapping[str, Annotated[Design, Key(file=read_design)]], "of the specimens"]
    trials: Annotated[tuple[Trial, ...], Key(absent=lambda table: ())]
    description: Annotated[str, Key(brief=True), "where it comes from"] = ""
    frame_rate: Annotated[float | None, FileUnit("Hz"), ABOVE_0, "nominal; a trial's own times rule"] = None
    accuracy: Annotated[Accuracy, Key(brief=True)] = USUAL
    rig_limits: Annotated[RigLimits, Key(brief=True), "of further trials"] = USUAL_LIMITS
    recording: Annotated[Mapping[str, RecordingTiming], Key(brief=True), "clocks of fused recordings, by trial"] = (
        field(default_factory=dict)
    )

    def resolved(self, table: Table) -> "MeasurementSet":
        """Raise InputError for a set without trials, and for trials of one name or one place in a session."""
        if not self.trials:
            raise table.error("no [[trials]]")
        files: set[str] = set()
        places: dict[tuple[str, int], Path] = {}
        for number, trial in enumerate(self.trials):
            where = table.inner("trials", number)
            if trial.file.name in files:
                raise where.error(f"file name {trial.file.name} is taken by another trial")
            if (other := places.setdefault((trial.design_name, trial.order), trial.file)) is not trial.file:
                raise where.error(
                    f"order = {trial.order} is that of {other.name} too; expected each trial's own place in the "
                    f"session of {trial.design_name}"
                )
            files.add(trial.file.name)
        return self
