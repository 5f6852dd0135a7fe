"""A target that cameras see: a sphere of known radius, or a ChArUco board; from it their poses to each other."""

from dataclasses import dataclass
from typing import Annotated

from fabdesign.formats.schema import Metre, Within
from fabdesign.formats.table import Table


@dataclass(frozen=True)
class SeenTarget:
    """Where the target was recorded, and what it is; one of `sphere` and `square`."""

    folder: Annotated[str, "with a file of each sensor, named as its own one, that sees the target at several places"]
    sphere: Annotated[Metre | None, Within(above=0, most=0.5), "radius"] = None
    square: Annotated[Metre | None, Within(above=0, most=0.5), "side of a square of a ChArUco board"] = None
    marker: Annotated[Metre | None, Within(above=0, most=0.5), "side of its markers"] = None
    size: Annotated[tuple[int, int], "squares across and down"] = (5, 7)
    dictionary: Annotated[str, "of its markers, as OpenCV names it"] = "DICT_4X4_50"

    def resolved(self, table: Table) -> "SeenTarget":
        """Raise InputError for none or both, and for a board without its markers' size."""
        if (self.sphere is None) == (self.square is None):
            raise table.error("expected sphere (a radius) or square (of a board)")
        if self.square is not None and (self.marker is None or self.marker >= self.square):
            raise table.bad("marker", "the side of the markers, less than square")
        return self
