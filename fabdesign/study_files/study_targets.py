"""Tables of a study that several kinds hold: `[target]`, which shows the shape that is wanted, `[price]` and
`[robust]`, which a search weighs besides the distance, and outputs of a shape in words, "height of corner (0.2, 0.2)".
"""

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError, note
from fabdesign.formats.schema import ABOVE_0, FROM_0, SHARE, FileUnit, Key, Metre, Millimetre, Within
from fabdesign.formats.table import Table
from fabdesign.geometry.placement import Unit
from fabdesign.geometry.shape import Face, Shape, at_places
from fabdesign.geometry.wishes import Region, TubeKeys, Weighting, Wish, WishKeys
from fabdesign.nouns.fabric import Fabric
from fabdesign.units import in_mm

_QUARTER_TOLERANCE = 0.002  # of a quarter turn: 1.57 and 3.1416 degrees are no angles that anybody turns by
_OF_WISHES = ("description", "weight", "wishes", "tube", "time")  # keys that a target of wishes may have


def _no_file(table: Table) -> Path:
    """Return what stands for a file: the study's own of wishes, a word of points."""
    if _points(table) is not None:
        return Path("target")
    if not _is_wished(table):
        raise table.missing("file")
    return table.file


def _points(table: Table) -> NDArray[Any] | None:
    """Return what Python gives; a file has none."""
    if table.has("points") and not isinstance(table["points"], np.ndarray):
        raise table.error("unknown key points")
    return table["points"] if table.has("points") else None


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

    Its points are scaled, turned and shifted in this order; `fit`: registered to the hanging cloth, with axes exchanged
    as need be unless there is a `rotation`. Of wishes `file` is the study's own. points (n, 3): of Python, for a file.
    """

    file: Annotated[Path, Key(absent=_no_file), "a trial, a cloud or a mesh"]
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
    points: Annotated[NDArray[Any] | None, Key("", absent=_points)] = field(default=None, compare=False)

    def resolved(self, table: Table) -> "TargetFile":
        """Return the target with its regions on the cloth. Raises InputError for keys that contradict each other."""
        if _is_wished(table):
            if other := next((key for key in table.names() if key not in _OF_WISHES), None):
                raise table.bad(other, "none beside wishes, which stand in the place of a file and have weights")
            return self
        turns = self.rotation or ()
        if any(abs(abs(turn) - k * np.pi / 2) < _QUARTER_TOLERANCE for turn in turns for k in (1, 2, 3)):
            note(f"{table.where}: rotation = {[*turns]} is read in degrees (is it in radians?)")
        if self.free and self.weighting:
            raise table.bad("free", "false beside regions, which are weighed where the target stands")
        if self.place == "fit" and "translation" in table:
            raise table.bad("translation", 'none beside place = "fit", which finds it')
        if self.points is None and not self.file.is_file():
            raise table.error(f"file {self.file} is not there")
        return replace(self, weighting=weighting_on_cloth(self.weighting, table))


@dataclass(frozen=True)
class Price:
    """The gain that muscles must bring to a layout whose number may vary."""

    muscle: Annotated[Millimetre, FROM_0, "of the objective that one more muscle must gain"] = 0.0  # m
    channel: Annotated[Millimetre, FROM_0, "of the objective that one more pressure channel must gain"] = 0.0  # m
    tolerance: Annotated[float, SHARE, "of the objective, by which fewer muscles may be worse in any case"] = 0.03

    def allowed(self, value: float, fewer: int) -> float:
        """Return the error [m] that is allowed to a layout with `fewer` muscles, each with its channel, less than one
        that reaches `value` m."""
        return max((1 + self.tolerance) * value, value + fewer * (self.muscle + self.channel))


NO_PRICE = Price()


@dataclass(frozen=True)
class Robust:
    """Scatter of what is built, as standard deviations, and what the result is chosen for."""

    placement: Annotated[Metre, Within(above=0, most=0.1), "of every corner point of a muscle, in u and in v"] = 0.002
    pressure: Annotated[float, Within(least=0, most=0.5), "of every channel, relative"] = 0.05
    muscle_gain: Annotated[float, Within(least=0, most=0.5), "of every muscle, relative"] = 0.04
    covariance: Annotated[bool, "the model's joint covariance scatters too, where it has one"] = True
    copies: Annotated[int, Within(least=8, most=1000), "of the result, true ones"] = 24
    tolerance: Annotated[Millimetre | None, ABOVE_0, "of a copy that counts; absent: 1.25 times the result"] = None  # m
    choose: Annotated[Literal["expected", "yield"], "for what the result is chosen"] = "expected"


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
    matches = [(kind, match) for kind, form in _FORMS.items() if (match := form.fullmatch(text.strip()))]
    if not matches:
        raise InputError(f"{where}: {text}; expected {EXPECTED}")
    [(kind, match)] = matches
    try:
        numbers = np.array([float(cell) for cell in match.groups()]).reshape(-1, 2)
    except ValueError:
        raise InputError(f"{where}: {text}: expected two numbers in each pair of brackets") from None
    shares = numbers / [fabric.width, fabric.height]
    if not ((shares >= -1e-9) & (shares <= 1 + 1e-9)).all():
        raise InputError(f"{where}: {text}: expected places on the cloth, {fabric.width:g} by {fabric.height:g} m")
    if len({*map(tuple, numbers.tolist())}) < len(numbers):
        raise InputError(f"{where}: {text}: one place twice; expected places apart")
    return ShapeOutput(text, kind, tuple((float(u), float(v)) for u, v in np.clip(shares, 0, 1)))


def read_shape_outputs(value: tuple[str, ...], table: Table) -> tuple[ShapeOutput, ...] | None:
    """Return the outputs of a study that is being decoded; None where one stands twice."""
    fabric = table.find("design").fabric
    outputs = tuple(read_shape_output(text, fabric, f"{table.where}: outputs") for text in value)
    return outputs if len({*value}) == len(value) else None
