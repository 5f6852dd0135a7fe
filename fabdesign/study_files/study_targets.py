"""`[target]` and `[[targets]]` of a study: which file shows the shape that is wanted, and how it counts."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np

from fabdesign.errors import note
from fabdesign.formats.schema import ABOVE_0, FileUnit, Key
from fabdesign.formats.table import Table
from fabdesign.geometry.placement import Unit
from fabdesign.geometry.regions import Region, Weighting
from fabdesign.geometry.shape import Face
from fabdesign.geometry.wishes import TubeKeys, Wish, WishKeys

_NEAR_RADIANS = 0.002  # of a quarter turn: 1.57 and 3.1416 degrees are no angles that anybody turns by
_OF_WISHES = ("description", "weight", "wishes", "tube", "time")  # keys that a target of wishes may have


def _file_of_wishes(table: Table) -> Path:
    if not _is_wished(table):
        raise table.missing("file")
    return table.file


def _is_wished(table: Table) -> bool:
    return bool(table.has("wishes") and table["wishes"]) or table.has("tube")


_REGIONS, _WISHES = (
    Key("regions", form=tuple[Region, ...]),
    Key(
        one_of={
            "wishes": Annotated[tuple[Wish, ...], Key(form=tuple[WishKeys, ...]), "where places of the cloth go"],
            "tube": Annotated[Wish, Key(form=TubeKeys), "to which the cloth is bent"],
        },
        several=True,
    ),
)
RegionsOfCloth = Annotated[Weighting | None, _REGIONS, "places of the cloth that count more, or less"]
_DEGREES = FileUnit("degrees")


def weighting_on_cloth(regions: Weighting | None, table: Table) -> Weighting | None:
    """Return the regions that a file lists, on the cloth of the study's design; None for none."""
    listed, fabric = cast(tuple[Region, ...], regions or ()), table.find("design").fabric
    return Weighting(listed, fabric.width, fabric.height) if listed else None


@dataclass(frozen=True)
class TargetFile:
    """A trial's npz with the frame that counts, or a cloud or mesh of any kind that `read_geometry` takes.

    Its points are scaled, turned and shifted in this order; `fit`: registered to the hanging cloth, with
    axes exchanged as need be unless there is a `rotation`. Of wishes `file` is the study's own.
    """

    file: Annotated[Path, Key(absent=_file_of_wishes), "a trial, a cloud or a mesh"]
    frame: Annotated[int, "of a trial"] = -1
    description: Annotated[str, "where it comes from; absent: what its measurement set says"] = ""
    unit: Annotated[Unit, "of the file; a trial says its own"] = "m"
    scale: Annotated[float, ABOVE_0, "beside the unit"] = 1.0
    rotation: Annotated[tuple[float, float, float] | None, _DEGREES, "about x, y, z, one after the other"] = None
    translation: Annotated[tuple[float, float, float], FileUnit("m"), "after the rotation"] = (0.0, 0.0, 0.0)
    place: Annotated[Literal["given", "fit"], "fit: found by registration, without translation"] = "given"
    weight: Annotated[float, ABOVE_0, "among several targets: errors are means by these"] = 1.0
    face: Annotated[Face, "that the points lie on"] = "both"
    distances: Annotated[Literal["both ways", "one way"], "one way: to the cloth alone"] = "both ways"
    free: Annotated[bool, "it may stand anywhere, and is moved while searching"] = False
    weighting: RegionsOfCloth = None
    wishes: Annotated[tuple[Wish, ...], _WISHES, "in place of a file: where places of the cloth go"] = ()

    def resolved(self, table: Table) -> "TargetFile":
        """Return the target with its regions on the cloth. Raises InputError for keys that contradict each other."""
        if _is_wished(table):
            if other := next((key for key in table.names() if key not in _OF_WISHES), None):
                raise table.bad(other, "none beside wishes, which stand in the place of a file and have weights")
            return self
        turns = self.rotation or ()
        if any(abs(abs(turn) - k * np.pi / 2) < _NEAR_RADIANS for turn in turns for k in (1, 2, 3)):
            note(f"{table.where}: rotation = {[*turns]} is read in degrees (is it in radians?)")
        if self.free and self.weighting:
            raise table.bad("free", "false beside regions, which are weighed where the target stands")
        if self.place == "fit" and "translation" in table:
            raise table.bad("translation", 'none beside place = "fit", which finds it')
        if not self.file.is_file():
            raise table.error(f"file {self.file} is not there")
        return replace(self, weighting=weighting_on_cloth(self.weighting, table))
