"""Outputs of a shape in words: "height of corner (0.2, 0.2)", a distance between two points, an angle at a point."""

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.formats.table import Table
from fabdesign.geometry.shape import Shape, at_places
from fabdesign.nouns.fabric import Fabric
from fabdesign.units import in_mm

_POINT = r"[\w\s-]*\(\s*([-+.\deE]+)\s*,\s*([-+.\deE]+)\s*\)"
_FORMS = {
    "x": re.compile(rf"x of {_POINT}"),
    "height": re.compile(rf"(?:height|y) of {_POINT}"),
    "z": re.compile(rf"z of {_POINT}"),
    "distance": re.compile(rf"distance from {_POINT} to {_POINT}"),
    "angle": re.compile(rf"angle at {_POINT} from {_POINT} to {_POINT}"),
}
EXPECTED = (
    '"height of NAME (u, v)" (or x of, z of), "distance from A (u, v) to B (u, v)" or '
    '"angle at A (u, v) from B (u, v) to C (u, v)", in metres from the upper left corner'
)


@dataclass(frozen=True)
class ShapeOutput:
    """A number of one shape. kind: of _FORMS; places: shares of width and height."""

    text: str
    kind: str
    places: tuple[tuple[float, float], ...]

    @property
    def unit(self) -> str:
        return "degrees" if self.kind == "angle" else "mm"

    def of(self, points: NDArray[np.floating[Any]]) -> float:
        """Return the value in its unit, of points (2 n n, 3) m: places on the mid-surface, in the world's frame, y = 0
        at the upper edge of the flat cloth."""
        at = in_mm(at_places(Shape.of(points).middle, self.places))
        if self.kind in ("x", "height", "z"):
            return float(at[0, ("x", "height", "z").index(self.kind)])
        if self.kind == "distance":
            return float(np.linalg.norm(at[1] - at[0]))
        one, other = at[1] - at[0], at[2] - at[0]
        return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


def read_shape_output(text: str, fabric: Fabric, where: str) -> ShapeOutput:
    """Read an output in words. Raises InputError for what is none of the forms, a place off the cloth, and a place
    named twice."""
    for kind, form in _FORMS.items():
        if matched := form.fullmatch(text.strip()):
            return ShapeOutput(text, kind, _places(matched.groups(), fabric, f"{where}: {text}"))
    raise InputError(f"{where}: {text}; expected {EXPECTED}")


def read_shape_outputs(value: tuple[str, ...], table: Table) -> tuple[ShapeOutput, ...] | None:
    """Return the outputs of a study that is being decoded; None where one stands twice."""
    fabric = table.find("design").fabric
    outputs = tuple(read_shape_output(text, fabric, f"{table.where}: outputs") for text in value)
    return outputs if len({*value}) == len(value) else None


def _places(cells: tuple[str, ...], fabric: Fabric, where: str) -> tuple[tuple[float, float], ...]:
    try:
        numbers = np.array([float(cell) for cell in cells]).reshape(-1, 2)
    except ValueError:
        raise InputError(f"{where}: expected two numbers in each pair of brackets") from None
    shares = numbers / [fabric.width, fabric.height]
    if not ((shares >= -1e-9) & (shares <= 1 + 1e-9)).all():
        raise InputError(f"{where}: expected places on the cloth, {fabric.width:g} by {fabric.height:g} m")
    if len({*map(tuple, numbers.tolist())}) < len(numbers):
        raise InputError(f"{where}: one place twice; expected places apart")
    return tuple((float(u), float(v)) for u, v in np.clip(shares, 0, 1))
