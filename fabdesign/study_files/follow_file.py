"""Study files of kind "follow": a target that moves, and what the regulator can do."""

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated

from fabdesign.files.design_file import read_design
from fabdesign.formats.schema import ABOVE_0, GRIDS, FileUnit, Key, Metre, Second, Within
from fabdesign.formats.table import Table
from fabdesign.geometry.placement import Unit
from fabdesign.geometry.shape import Face
from fabdesign.nouns.design import Design
from fabdesign.nouns.model import POINTS_PER_SIDE, Model
from fabdesign.nouns.pressure import USUAL_LIMITS, PressureProgram, RigLimits
from fabdesign.runtime.effort import LONGEST
from fabdesign.study_files.study_file import (
    MuscleChoice,
    Name,
    Order,
    Seed,
    StudyFile,
    StudyLimits,
    StudyModel,
    read_program,
)
from fabdesign.study_files.study_targets import RegionsOfCloth, TargetFile, weighting_on_cloth

_THERE = Key(there=Path.exists)


@dataclass(frozen=True)
class MovingTarget:
    """A trial, a motion, or a folder with a cloud or mesh for each instant."""

    file: Annotated[Path, _THERE, "a trial, a motion, or a folder of clouds or meshes in the order of their names"]
    frame_rate: Annotated[float, FileUnit("Hz"), ABOVE_0, "of a folder; a trial or motion says its times"] = 30.0
    until: Annotated[Second | None, ABOVE_0, "after rest; absent: to its end"] = None
    unit: Annotated[Unit, "of a folder's files"] = "m"
    face: Annotated[Face, "that its points lie on"] = "both"
    weighting: RegionsOfCloth = None

    def resolved(self, table: Table) -> "MovingTarget":
        """Return the target with its regions on the cloth."""
        return replace(self, weighting=weighting_on_cloth(self.weighting, table))


@dataclass(frozen=True)
class Moment:
    """A shape that is wanted at an instant: a target as in a search, or wishes."""

    time: Annotated[Second, Within(above=0, most=LONGEST), "after rest"]
    target: Annotated[TargetFile, Key(inside=True)]


@dataclass(frozen=True)
class MotionScatter:
    """How the motion is tried beside its own program."""

    pressure: Annotated[float, Within(least=0, most=0.5), "of every channel, relative, as standard deviation"] = 0.01
    copies: Annotated[int, Within(least=0, most=100), "of the motion, with a model drawn from the covariance each"] = 7


@dataclass(frozen=True)
class LayoutChoice:
    """A layout that is searched for, by its shapes at rest at some instants, before it is driven."""

    muscles: MuscleChoice
    instants: Annotated[int, Within(least=1, most=12), "whose shapes are wanted of it, the last one among them"] = 4
    seconds: Annotated[Second, ABOVE_0, "of search"] = 120.0
    spacing: Annotated[Metre, Within(least=0), "between muscles on one face"] = StudyLimits.spacing
    edge: Annotated[Metre, Within(least=0), "between a muscle's corner points and the cloth's edge"] = StudyLimits.edge


_EITHER = "one [motion], or [[moments]] with their times"
_TARGET = Key(
    expected=_EITHER,
    one_of={
        "motion": Annotated[MovingTarget, "the motion that is wanted"],
        "moments": Annotated[
            tuple[Moment, ...], "poses: shapes and their times; between them the cloth goes by shapes at rest"
        ],
    },
)
_GRID = Key(absent=lambda table: (table.decoded["model"] or Model()).points_per_side)


@dataclass(frozen=True, eq=False)
class FollowStudy(StudyFile):
    """Pressures over time that bring a design nearest to a target that moves."""

    kind = "follow"
    name: Name
    design: Annotated[Design, Key(file=read_design), "whose pressures are sought"]
    target: Annotated[MovingTarget | tuple[Moment, ...], _TARGET]
    model: StudyModel = None
    seed: Seed = 1
    order: Order = 0
    rig: Annotated[RigLimits, Key("rig_limits"), "what the regulator can do"] = USUAL_LIMITS
    start: Annotated[
        PressureProgram | None, Key(form=str, read=read_program), "a program to begin with; absent: from shapes at rest"
    ] = None
    layout: Annotated[LayoutChoice | None, "absent: the design's own"] = None
    scatter: MotionScatter = MotionScatter()
    points_per_side: Annotated[int, _GRID, GRIDS, "absent: the model's, or 41"] = POINTS_PER_SIDE
    seconds: Annotated[Second | None, Key("limits.seconds"), ABOVE_0, "then no further window is begun"] = None

    def resolved(self, table: Table) -> "FollowStudy":
        """Return the study with its moments by rising time. Raises InputError for two at one instant, and for a design
        that cannot be driven."""
        if self.layout is not None and self.start is not None:
            raise table.bad("start", "none beside [layout], whose channels are not known")
        if not self.design.muscles and self.layout is None:
            raise table.error(f"design {self.design.name} has no muscles; expected some")
        if self.rig.channels is not None and self.design.channels > self.rig.channels:
            raise table.error(
                f"design {self.design.name} has {self.design.channels} channels; the rig has {self.rig.channels}"
            )
        if not isinstance(self.target, tuple):
            return self
        if not self.target:
            raise table.error(f"expected {_EITHER}")
        moments = sorted(self.target, key=lambda moment: moment.time)
        for one, other in pairwise(moments):
            if other.time - one.time < 1e-6:
                raise table.error(f"moments: two at {one.time:g} s; expected one at each time")
        return replace(self, target=tuple(moments))
