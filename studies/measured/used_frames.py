"""Which frames of a trial are used, and which stretches are left out because they are sensitive (near a bifurcation).

Equal pressures on both faces of a symmetric layout buckle it to either side, and after a snap the cloth stays there. No
fit can learn from such a stretch, and no error there says anything of a model: calibrate, trace, evaluate and train
leave it out. `studies.measured.sensitive_stretches` finds them, once for a trial.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.formats.json_file import plain
from fabdesign.formats.schema import Key
from fabdesign.nouns.array import Array
from fabdesign.nouns.trial import MeasurementSet, Trial

Flags = NDArray[np.bool_]

WHY = "tilting the frame by 0.05 degrees and changing the pressures by 1 % leads to another shape there"


@dataclass(frozen=True)
class Stretch:
    """A sensitive stretch of a trial, which is left out; both ends included."""

    trial: str
    begin: Annotated[float, Key("from_s")]  # s after rest
    end: Annotated[float, Key("to_s")]  # s
    why: str = WHY
    set_name: Annotated[str, Key("set")] = ""  # of the trial's set; empty where there is but one

    def as_json(self) -> dict[str, Any]:
        """Return it as files have it, with its set only where there are several."""
        return {key: value for key, value in plain(self).items() if value != ""}

    @property
    def named(self) -> str:
        """Return its name for people."""
        trial = f"{self.set_name}/{self.trial}" if self.set_name else self.trial
        return f"{trial} {self.begin:.1f} to {self.end:.1f} s"


def used_mask(stretches: Sequence[Stretch], trial: str, times: Array, *, set_name: str = "") -> Flags:
    """Return (T,) whether each frame of a trial, at `times` [s], is used. set_name: as in the stretches."""
    of_trial = [s for s in stretches if (s.set_name, s.trial) == (set_name, trial)]
    inside = [(s.begin - 1e-9 <= times) & (times <= s.end + 1e-9) for s in of_trial]
    return ~np.any(inside, axis=0) if inside else np.ones(len(times), dtype=bool)


def share_left_out(stretches: Sequence[Stretch], trials: Sequence[Trial], *, set_name: str = "") -> float:
    """Return the share of all frames of the trials of one set."""
    used = [used_mask(stretches, trial.name, trial.times, set_name=set_name) for trial in trials]
    return float(1 - np.concatenate(used).mean()) if used else 0.0


def left_out_in_words(stretches: Sequence[Stretch], share: float) -> str:
    """Return a line for people. share: of the frames that are left out."""
    if not stretches:
        return "all frames are used: no stretch is sensitive to small changes of the inputs"
    return f"left out as sensitive, {share:.0%} of the frames: {', '.join(s.named for s in stretches)}; {WHY}"


@dataclass(frozen=True, eq=False)
class UsedFrames:
    """Which frames of the trials of some sets are used. stretches: left out; None where they were not looked for."""

    stretches: tuple[Stretch, ...] | None
    share_left_out: float  # of the trials' frames
    several: bool = False  # sets: stretches are then named by set and trial

    def at(self, measured: MeasurementSet, trial: Trial, times: Array | None = None) -> Flags:
        """Return (T,) whether each frame of a trial of the set is used, or what is seen at `times` [s] of it."""
        times = trial.times if times is None else times
        return used_mask(self.stretches or (), trial.name, times, set_name=measured.name if self.several else "")

    def as_json(self) -> dict[str, Any]:
        """Return the keys `unjudged` and `share_unjudged` of every command."""
        listed = None if self.stretches is None else [stretch.as_json() for stretch in self.stretches]
        return {"unjudged": listed, "share_unjudged": self.share_left_out}

    @property
    def in_words(self) -> str:
        if self.stretches is None:
            return "all frames are used; sensitive stretches were not looked for"
        return left_out_in_words(self.stretches, self.share_left_out)
