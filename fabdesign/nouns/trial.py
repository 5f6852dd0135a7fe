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
from fabdesign.formats.schema import ABOVE_0, FileUnit, Key, Within
from fabdesign.formats.table import Table, nearest
from fabdesign.geometry.trial_place import require_on_cloth
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import PressureProgram, require_pressures
from fabdesign.study_files.rig_limits_file import USUAL_LIMITS, RigLimits
from fabdesign.units import InFile

Role = Literal["fit", "test"]


def _design_of(table: Table) -> Design:
    name, designs = table.decoded["design_name"], table.find("designs")
    if name not in designs:
        raise table.bad("design", f"one of [designs], {', '.join(designs)}{nearest(name, [*designs])}")
    return cast(Design, designs[name])


@dataclass(frozen=True)
class Trial:
    """One motion of a set. Its file is opened when its content is asked for; that raises InputError."""

    file: Annotated[Path, "the npz"]
    design_name: Annotated[str, Key("design"), "one of [designs]"]
    design: Annotated[Design, Key("", absent=_design_of)]
    order: Annotated[int, "place in the specimen's session, for what builds up from trial to trial"]
    role: Annotated[Role, "nothing may be fitted or chosen on test"]
    _sound: list[bool] = field(default_factory=list, init=False, repr=False, compare=False)  # filled once it is

    def resolved(self, table: Table) -> "Trial":
        """Raise InputError for a file that is not there."""
        if not self.file.is_file():
            raise table.error(f"file {self.file} is not there")
        return self

    @property
    def name(self) -> str:
        return self.file.stem

    @cached_property
    def times(self) -> NDArray[np.float64]:
        """(T,) s after rest."""
        return read_trial_pressures(self.file)[0]

    @cached_property
    def program(self) -> PressureProgram:
        """The set points, checked against the design's channels and the muscles' limits."""
        program = program_of(*read_trial_pressures(self.file))
        require_pressures(program, self.design, str(self.file))
        return program

    def load(self) -> TrialData:
        """All arrays, checked, the first time also against the design: its channels, its limits, where its cloth can
        be. The clouds are not kept by the trial."""
        data = read_trial(self.file, size=max(self.design.fabric.width, self.design.fabric.height))
        if not self._sound:
            require_pressures(data.program, self.design, str(self.file))
            require_on_cloth(data.frames, data.time, self.design.fabric, str(self.file))
            self._sound.append(True)
        return data


_TILT = Key("tilt_deg")


@dataclass(frozen=True)
class Accuracy:
    """Standard deviations of what the trials were given. By default those of a laboratory that says nothing of them."""

    pressure: Annotated[float, Within(least=0, most=1), "of a channel, as a share of it; with tilt_deg 0: exact"] = 0.01
    tilt: Annotated[float, _TILT, InFile("tilt_deg"), FileUnit("degrees"), Within(least=0, most=45), "of the level"] = (
        0.5
    )

    @property
    def is_exact(self) -> bool:
        return not (self.pressure or self.tilt)

    @staticmethod
    def worst(accuracies: "Sequence[Accuracy]") -> "Accuracy":
        return Accuracy(max(one.pressure for one in accuracies), max(one.tilt for one in accuracies))


USUAL = Accuracy()


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
