"""`[target]` and `[[targets]]` of a study: which file shows the shape that is wanted, and how it counts."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from fabdesign.errors import InputError, note
from fabdesign.fabric import Fabric
from fabdesign.placement import UNITS, Unit
from fabdesign.regions import Weighting, read_regions
from fabdesign.sheet import Face
from fabdesign.table import Table
from fabdesign.wishes import Wish, read_wishes

_NEAR_RADIANS = 0.002  # of a quarter turn: 1.57 and 3.1416 degrees are no angles that anybody turns by


@dataclass(frozen=True)
class TargetFile:
    """A trial's npz with the frame that counts, or a cloud or mesh of any kind that `read_geometry` takes.

    Its points are scaled, turned and shifted in this order; `fit`: registered to the hanging cloth, with
    axes exchanged as need be unless there is a `rotation`.
    """

    file: Path
    frame: int = -1
    description: str = ""  # where it comes from; by default what its measurement set says
    unit: Unit = "m"
    scale: float = 1.0  # beside the unit
    rotation: tuple[float, float, float] | None = None  # degrees about the fixed axes x, y, z, in this order
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m
    place: Literal["given", "fit"] = "given"
    weight: float = 1.0  # among the poses of a study
    face: Face = "both"  # that the points lie on
    # one way: from the points, which show a part, to the cloth alone
    distances: Literal["both ways", "one way"] = "both ways"
    free: bool = False  # it may stand anywhere: moved while searching
    weighting: Weighting | None = None  # of places of the cloth
    wishes: tuple[Wish, ...] = ()  # in place of a cloud: `file` is then the study's own


def read_targets(root: Table, path: Path, fabric: Fabric) -> tuple[TargetFile, ...]:
    """Of `[target]` or `[[targets]]` in the study at `path`, for a cloth."""
    single = root.table("target", None)
    tables = root.tables("targets")
    if (single is None) == (not tables):
        raise InputError(f"{path}: expected one [target], or [[targets]] that share one layout")
    targets = []
    for table in [single] if single is not None else tables:
        if wishes := read_wishes(table, fabric):
            targets.append(_wished(table, path, wishes))
            continue
        target = TargetFile(
            file=table.path("file", path.parent),
            frame=table.integer("frame", -1),
            description=table.text("description", ""),
            unit=table.text("unit", "m", choices=tuple(UNITS)),
            scale=table.number("scale", 1.0, above=0),
            rotation=table.numbers("rotation", None, count=3),
            translation=table.numbers("translation", (0.0, 0.0, 0.0), count=3),
            place=table.text("place", "given", choices=("given", "fit")),
            weight=table.number("weight", 1.0, above=0),
            face=table.text("face", "both", choices=("both", "front", "back")),
            distances=table.text("distances", "both ways", choices=("both ways", "one way")),
            free=table.flag("free", False),
            weighting=read_regions(table, fabric),
        )
        turns = target.rotation or ()
        if any(abs(abs(turn) - k * np.pi / 2) < _NEAR_RADIANS for turn in turns for k in (1, 2, 3)):
            note(f"{table.where}: rotation = {[*turns]} is read in degrees (is it in radians?)")
        if target.free and target.weighting is not None:
            raise table.bad("free", "false beside regions, which are weighed where the target stands")
        if target.place == "fit" and "translation" in table:
            raise table.bad("translation", 'none beside place = "fit", which finds it')
        table.finish()
        if not target.file.is_file():
            raise InputError(f"{table.where}: file {target.file} is not there")
        targets.append(target)
    return tuple(targets)


def _wished(table: Table, path: Path, wishes: tuple[Wish, ...]) -> TargetFile:
    if "file" in table:
        raise table.bad("file", "none beside wishes, which stand in its place")
    if "regions" in table:
        raise InputError(f"{table.where}: regions beside wishes, which have weights of their own; expected none")
    description, weight = table.text("description", ""), table.number("weight", 1.0, above=0)
    table.finish()
    return TargetFile(path, description=description, weight=weight, wishes=wishes)
