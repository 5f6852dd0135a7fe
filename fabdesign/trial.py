"""Trials: one measured motion each, and the sets they come in."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.pressure import PressureProgram, require_pressures
from fabdesign.rig_limits_file import USUAL_LIMITS, RigLimits
from fabdesign.trial_file import TrialData, program_of, read_trial, read_trial_pressures
from fabdesign.trial_place import require_on_cloth
from fabdesign.units import InFile

Role = Literal["fit", "test"]


@dataclass(frozen=True)
class Trial:
    """One motion of a set. Its file is opened when its content is asked for; that raises InputError."""

    file: Path  # the npz
    design_name: str
    design: Design
    order: int  # place in the specimen's session
    role: Role  # nothing may be fitted or chosen on "test"
    _sound: list[bool] = field(default_factory=list, init=False, repr=False, compare=False)  # filled once it is

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


@dataclass(frozen=True)
class Accuracy:
    """Standard deviations of what a trial was given: of a channel's pressure, as a share of it, and of the frame's
    level [degrees]. By default those of a laboratory that says nothing of them."""

    pressure: float = 0.01
    tilt: Annotated[float, InFile("tilt_deg")] = 0.5

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

    name: str
    designs: Mapping[str, Design]
    trials: tuple[Trial, ...]
    description: str = ""
    frame_rate: float | None = None  # Hz, nominal; a trial's own times rule
    accuracy: Accuracy = USUAL  # of the trials' pressures and the frame's level
    rig_limits: RigLimits = USUAL_LIMITS  # of further trials
