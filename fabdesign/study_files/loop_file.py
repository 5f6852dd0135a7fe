"""Study files of kind "loop": a target, a start design, and where measurements come from."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from fabdesign.formats.schema import ABOVE_0, FROM_0, GRIDS, Key, Metre, Millimetre, Second, Within
from fabdesign.formats.table import Table
from fabdesign.nouns.model import POINTS_PER_SIDE
from fabdesign.nouns.pressure import RigLimits
from fabdesign.nouns.trial import LEAST_TRIALS
from fabdesign.runtime.effort import LONGEST
from fabdesign.study_files.study_file import Study, StudyFile, require_searchable
from fabdesign.units import in_kpa

HOLD = 2.0  # s, for which the pressures of a shape at rest are held on the device
TRACE_GRID = 21  # points a side: a trace asks for hundreds of motions
UNLIMITED = RigLimits(np.inf, np.inf, LONGEST)
_TRUTH = Key("key", there=Path.is_file)


@dataclass(frozen=True)
class VirtualRig:
    """Measures by `fabdesign rig`. None: the rig's own."""

    truth: Annotated[Path | None, _TRUTH, "ground truth of the specimens; absent: the data sheet"] = None
    element: Annotated[Metre | None, Within(least=0.002, most=0.05), "of its mesh"] = None
    step: Annotated[Second | None, Within(least=1e-4, most=0.01), "of its time steps"] = None


@dataclass(frozen=True)
class Laboratory:
    """Puts a measurement set into `folder`/turn_K when asked. tail_length, paper: as `export` takes them."""

    folder: Annotated[Path, "where sets are expected: in turn_0, turn_1, ... of it"]
    tail_length: Annotated[Metre | None, Within(least=0, most=1), "absent: the muscle types' own"] = None
    paper: Annotated[Literal["a4", "letter", "none"] | None, "of templates"] = "a4"

    def resolved(self, table: Table) -> "Laboratory":
        return replace(self, paper=None) if self.paper == "none" else self


_NUMBER = Key(absent=lambda table: max(4, LEAST_TRIALS + table.decoded.get("held_out", 1)))
_RIG_OR_LABORATORY = "one source of measurements, [rig] or [laboratory]"
_SOURCE = Key(expected=_RIG_OR_LABORATORY, one_of={"rig": VirtualRig, "laboratory": Laboratory})


@dataclass(frozen=True)
class Trials:
    """The programs that are run on a design beside its own pressures."""

    number: Annotated[int, _NUMBER, Within(least=0, most=100), "programs"] = 4
    seconds: Annotated[Second, Within(least=0.2, most=60), "of each"] = 1.5
    held_out: Annotated[int, FROM_0, "the last so many have role test"] = 1

    def resolved(self, table: Table) -> "Trials":
        """Raise InputError for too few to calibrate on."""
        if self.number < LEAST_TRIALS - 1 + self.held_out:  # a shape's own rise is a trial too
            raise table.error(
                f"number = {self.number}, held_out = {self.held_out}; expected {LEAST_TRIALS - 1} more "
                "than are held out, to calibrate on"
            )
        return self


@dataclass(frozen=True)
class Learning:
    """The steps that a turn's measurements go through."""

    trace: Annotated[bool, "whether what the model lacks is looked for"] = True
    tolerance: Annotated[Millimetre, ABOVE_0, "of excess, of the trace"] = 0.5e-3  # m
    trace_grid: Annotated[int, GRIDS, "points a side; if points_per_side: the trace's own refit is taken"] = TRACE_GRID
    train: Annotated[Literal["field", "paper"] | None, "the corrector's network; absent: none"] = None
    train_trials: Annotated[int, Within(least=2), "of role fit, from which on there is one"] = 20


@dataclass(frozen=True)
class StopRule:
    """When the loop ends."""

    turns: Annotated[int, Within(least=0, most=100), "after the first design"] = 2
    excess: Annotated[Millimetre, FROM_0, "of surface excess on the device: near enough"] = 0.5e-3  # m
    gain: Annotated[float, Within(least=-10, most=1), "share of the least excess; less: the last turn"] = 0.1


@dataclass(frozen=True, eq=False)
class LoopStudy(StudyFile):
    """search: the choice of every turn; its model is what is known at first."""

    kind = "loop"
    search: Annotated[Study, Key(inside=True)]
    source: Annotated[VirtualRig | Laboratory, _SOURCE]
    rig_limits: RigLimits = UNLIMITED
    trials: Trials = Trials()
    learning: Learning = Learning()
    stop: StopRule = StopRule()
    points_per_side: Annotated[int, GRIDS, "of the search's full model and the fit"] = POINTS_PER_SIDE

    def resolved(self, table: Table) -> "LoopStudy":
        """Return the study within what the rig can do: no higher pressure, no faster rise. Raises InputError for what
        it cannot."""
        require_searchable(self.search, table.where)
        search, rig, low, high = self.search, self.rig_limits, self.search.limits.pressure[0], self.highest
        if low >= high:
            raise table.error(
                f"limits: pressure from {in_kpa(low):g} kPa; expected less than the rig's {in_kpa(high):g} kPa"
            )
        search = replace(
            search,
            limits=replace(search.limits, pressure=(low, high)),
            rise=max(search.rise, high / rig.rate),
            hold=search.hold if "hold" in table else HOLD,
        )
        longest = max(search.rise + search.hold, self.trials.seconds)
        if longest > rig.duration:
            raise table.error(
                f"rig_limits: duration = {rig.duration:g}; a rise of {search.rise:g} s with its hold and the trials "
                f"take up to {longest:g} s"
            )
        most = search.design.channels if search.muscles is None else search.muscles.most
        if rig.channels is not None and most > rig.channels:
            raise table.error(f"up to {most} muscles; the rig has {rig.channels} channels")
        if isinstance(self.source, Laboratory) and self.source.tail_length is None:
            for name, kind in search.design.muscle_types.items():
                if kind.tail_length is None:
                    raise table.error(
                        f"laboratory: muscle type {name} has no tail_length; expected one there, in m, for the cut list"
                    )
        return replace(self, search=search)

    @property
    def highest(self) -> float:
        """Return Pa, of any set point."""
        return min(self.search.limits.pressure[1], self.rig_limits.pressure)
