"""Study files of kind "unseen": a layout or muscle type predicted before it is sewn, and designs left out in turn."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.files.design_file import read_design
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model
from fabdesign.formats.codec import as_number
from fabdesign.formats.schema import ABOVE_0, GRIDS, Key, Second, Within
from fabdesign.formats.table import Table
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import HOLD, RISE
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import joint_root
from fabdesign.nouns.pressure import USUAL_LIMITS, PressureProgram, RigLimits, limits
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.study_files.study_file import Hold, Name, Outputs, Rise, Seed, StudyFile, read_program
from fabdesign.units import pascals

GRID = 21  # points a side, where there is no model whose factors belong to a grid
FREE = "measured.free:"  # as an error says it
_DESIGN_FILE = Key(file=read_design, absent=lambda table: table.find("design"))


@dataclass(frozen=True, eq=False)
class CandidateMeasurement:
    """A measurement that could be made: a program on a design."""

    name: Annotated[str, Key(absent=lambda table: str(table["program"])), "absent: the program"]
    design: Annotated[Design, _DESIGN_FILE, "absent: the study's"]
    program: Annotated[PressureProgram, Key(form=str, read=read_program), "a file or a row, as simulate takes it"]


def _poses(value: Any, table: Table) -> NDArray[np.float64]:
    """Return (n, channels) Pa of rows of kPa. Raises InputError, also for pressures beyond the muscles' limits."""
    most = limits(table.find("design"))
    expected = f"rows of {len(most)} pressures in kPa, within the muscles' limits"
    try:
        poses = np.array([[pascals(str(as_number(x))) for x in row] for row in value])
    except (ArithmeticError, TypeError, ValueError):
        raise table.bad("pressures", expected) from None
    if poses.ndim != 2 or poses.shape[1] != len(most) or not ((poses >= 0) & (poses <= most)).all():
        raise table.bad("pressures", expected)
    return poses


def _each_face(table: Table) -> NDArray[np.float64]:
    """Return one face after the other at the highest pressure, (n, channels) Pa."""
    design: Design = table.find("design")
    most, rig = limits(design), table.find("rig") or USUAL_LIMITS
    on = {side: {m.channel for m in design.muscles if m.side == side} for side in ("front", "back")}
    faces = [np.isin(np.arange(design.channels), [*channels]) for channels in on.values() if channels]
    return np.array([np.where(face, np.minimum(most, rig.pressure), 0.0) for face in faces])


_POSES = Key("pressures", read=_poses, absent=_each_face)


@dataclass(frozen=True, eq=False)
class Unsewn:
    """A layout that is not sewn yet: a design under `poses` (n, channels) Pa, the model that is to predict it, and what
    is said of its shapes beside the lower edge."""

    design: Annotated[Design, Key(file=read_design), "what is to be predicted; absent: only [measured]"]
    model: Annotated[Model, Key(file=read_model), "with a [covariance]"]
    poses: Annotated[NDArray[np.float64], _POSES, "kPa, a row a pose; absent: the front at 300, the back at 300"]
    outputs: Outputs = ()
    candidates: Annotated[tuple[CandidateMeasurement, ...], "absent: steps, staircases and ramps"] = ()

    def resolved(self, table: Table) -> "Unsewn":
        """Raise InputError for a model without a sound covariance, and a design without muscles."""
        joint_root(self.model)  # sound, or said at once
        if not self.design.muscles:
            raise table.error(f"design {self.design.name} has no muscles; expected some")
        return self


_SET = Key("measured.set", file=read_set)
_GRID = Key(absent=lambda table: sewn.model.points_per_side if (sewn := table.decoded["unsewn"]) else GRID)


@dataclass(frozen=True, eq=False)
class UnseenStudy(StudyFile):
    """trials: of each design that is left out, how many are evaluated at most. free: effects that are fitted to the
    others besides, as `calibrate --free` takes them. samples: models drawn."""

    kind = "unseen"
    name: Name
    rig: Annotated[RigLimits, Key("rig_limits"), "of poses and programs that the study does not name"] = USUAL_LIMITS
    unsewn: Annotated[Unsewn | None, Key(inside=True)] = None
    measured: Annotated[MeasurementSet | None, _SET, "of two designs or more: each left out in turn"] = None
    trials: Annotated[int, Key("measured.trials"), Within(least=1), "of the one left out, evaluated at most"] = 12
    free: Annotated[tuple[str, ...], Key("measured.free"), "effects fitted besides, as for calibrate --free"] = ()
    samples: Annotated[int, Within(least=8, most=1000), "models drawn"] = 32
    seed: Seed = 1
    points_per_side: Annotated[int, _GRID, GRIDS, "absent: the model's, or 21 without one"] = GRID
    rise: Rise = RISE
    hold: Hold = HOLD
    seconds: Annotated[Second | None, Key("limits.seconds"), ABOVE_0, "then no further piece is begun"] = None

    def resolved(self, table: Table) -> "UnseenStudy":
        """Raise InputError for nothing to compute, one measured design, and a rig with too few channels."""
        if "measured" in table and self.measured is None:
            raise table.within(["measured"]).missing("set")
        if self.unsewn is None and self.measured is None:
            raise table.error("nothing to compute; expected a design with a model, a [measured] set, or both")
        if self.measured is not None and len(self.measured.designs) < 2:
            raise table.within(["measured"]).error("one design; expected two or more, to leave each out in turn")
        design = self.unsewn.design if self.unsewn else None
        if design and self.rig.channels is not None and design.channels > self.rig.channels:
            raise table.error(f"design {design.name} has {design.channels} channels; the rig has {self.rig.channels}")
        return self
