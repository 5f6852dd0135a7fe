"""Sewing templates: what is to be cut, hung and laced, a face of the design as it is seen, drawn flat in millimetres, x
right and y down. SVG and PDF pages are made of such drawings."""

from dataclasses import dataclass
from math import atan2, cos, degrees, dist, radians, sin
from textwrap import wrap
from typing import Any, Literal
from xml.etree import ElementTree as ET

from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from fabdesign.units import in_mm

Point = tuple[float, float]  # mm
_LETTER = 0.62  # of the size, a letter's width, wide ones and bold among them
_MARGIN = 15.0  # mm around the cloth that is cut
_HEAD = 12.0  # mm above it, for the title
_LINE = 4.4  # mm, of its further lines
_FOOT = 18.0  # mm below it, for the bar
_BAR = 100.0  # mm
_TWO_LABELS = 60.0  # mm: a muscle as long as this is labelled at both ends
# Okabe and Ito's colours: they differ for colour-blind people too
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8a7a00")


@dataclass(frozen=True)
class Line:
    """Straight from point to point."""

    points: tuple[Point, ...]
    width: float  # mm
    colour: str = "black"
    closed: bool = False
    dashed: bool = False

    def svg(self) -> ET.Element:
        style = {"fill": "none", "stroke": self.colour, "stroke-width": f"{self.width:g}"}
        if self.dashed:
            style["stroke-dasharray"] = "3 2"
        points = " ".join(f"{x:.3f},{y:.3f}" for x, y in self.points)
        return ET.Element("polygon" if self.closed else "polyline", {"points": points, **style})

    def draw(self, axes: Any, unit: float, order: int) -> None:
        from matplotlib.patches import Polygon

        dash = (0, (3 / self.width, 2 / self.width)) if self.dashed else "solid"
        style = {"fill": False, "edgecolor": self.colour, "linewidth": self.width * unit, "linestyle": dash}
        axes.add_patch(Polygon(self.points, closed=self.closed, zorder=order, **style))


@dataclass(frozen=True)
class Circle:
    centre: Point
    radius: float  # mm
    width: float  # mm, of its line
    colour: str = "black"
    fill: str = "white"

    def svg(self) -> ET.Element:
        place = {"cx": f"{self.centre[0]:.3f}", "cy": f"{self.centre[1]:.3f}", "r": f"{self.radius:g}"}
        style = {"fill": self.fill, "stroke": self.colour, "stroke-width": f"{self.width:g}"}
        return ET.Element("circle", place | style)

    def draw(self, axes: Any, unit: float, order: int) -> None:
        from matplotlib.patches import Circle as Disc

        style = {"facecolor": self.fill, "edgecolor": self.colour, "linewidth": self.width * unit}
        axes.add_patch(Disc(self.centre, self.radius, zorder=order, **style))


@dataclass(frozen=True)
class Words:
    at: Point  # on the base line
    text: str
    size: float  # mm
    colour: str = "black"
    anchor: Literal["start", "middle", "end"] = "start"
    turn: float = 0.0  # degrees, clockwise
    bold: bool = False

    def svg(self) -> ET.Element:
        x, y = (f"{value:.3f}" for value in self.at)
        style = {"x": x, "y": y, "font-size": f"{self.size:g}", "fill": self.colour, "text-anchor": self.anchor}
        if self.turn:
            style["transform"] = f"rotate({self.turn:g} {x} {y})"
        if self.bold:
            style["font-weight"] = "bold"
        element = ET.Element("text", style)
        element.text = self.text
        return element

    def draw(self, axes: Any, unit: float, order: int) -> None:
        sides = {"start": "left", "middle": "center", "end": "right"}
        style = {"fontsize": self.size * unit, "color": self.colour, "ha": sides[self.anchor], "va": "baseline"}
        turned = {"rotation": -self.turn, "rotation_mode": "anchor", "clip_on": True, "zorder": order}
        weight = "bold" if self.bold else "normal"
        axes.text(*self.at, self.text, weight=weight, parse_math=False, **style, **turned)


# A shape gives its SVG element, whose unit is the millimetre, and draws itself on axes of Matplotlib; unit: points in
# its millimetre.
Shape = Line | Circle | Words


@dataclass(frozen=True)
class Drawing:
    """Shapes, in the order in which they are drawn, and the box (left, top, right, bottom) that holds them, mm."""

    shapes: tuple[Shape, ...]
    box: tuple[float, float, float, float]


def scale_bar(start: Point, *, upright: bool = False) -> list[Shape]:
    """Return a bar of 100 mm to check a print by, to the right or up: ticks every 10 mm on one side of the line, and
    what to measure on the other."""
    x, y = start

    def at(along: float, across: float) -> Point:
        return (x + across, y - along) if upright else (x + along, y - across)

    shapes: list[Shape] = [Line((start, at(_BAR, 0)), 0.4)]
    shapes += [Line((at(10 * i, 0), at(10 * i, 2.0 if i % 5 else 4.0)), 0.3) for i in range(11)]
    text = f"measure this: {_BAR:g} mm"
    return [
        *shapes,
        Words(at(50, -2), text, 3.2, anchor="middle", turn=-90) if upright else Words(at(0, -4.2), text, 3.2),
    ]


def size_within(text: str, width: float, size: float) -> float:
    """Return the size [mm] of words, at most `size`, at which they fit a width [mm]."""
    return min(size, width / (_LETTER * max(len(text), 1)))


def cross(centre: Point, size: float, width: float, colour: str) -> list[Shape]:
    """Return an upright cross, `size` from arm's end to arm's end."""
    (x, y), half = centre, size / 2
    return [
        Line(((x - half, y), (x + half, y)), width, colour),
        Line(((x, y - half), (x, y + half)), width, colour),
    ]


def laced_sides(design: Design) -> list[str]:
    """Return the faces that have muscles, the front where none has."""
    laced = {muscle.side for muscle in design.muscles} or {"front"}
    return [side for side in ("front", "back") if side in laced]


def face_drawing(design: Design, side: str, *, seam_allowance: float) -> Drawing:
    """Return one face ("front" or "back") as it is seen, so the back is mirrored; origin at the upper corner on the
    left.

    It shows the cloth's outline and hung edge, the line to cut along `seam_allowance` [m] outside it, and each
    muscle's line with its fixed points, number and channel, and u, v of its ends and corners in mm.
    """
    width, height = in_mm(design.fabric.width), in_mm(design.fabric.height)
    shapes = [*_outlines(width, height, in_mm(seam_allowance)), *_hung(design, side)]
    for number, muscle in enumerate(design.muscles):
        if muscle.side == side:
            shapes += _muscle(muscle, number, design.fabric.width)
    around = max(in_mm(seam_allowance), 5.0)
    return Drawing(tuple(shapes), (-around, -around, width + around, height + around))


def template_sheet(design: Design, side: str, *, seam_allowance: float) -> Drawing:
    """Return a face with its title and a bar of 100 mm to check the print by, on one sheet."""
    face = face_drawing(design, side, seam_allowance=seam_allowance)
    left, top, right, bottom = face.box
    width = max(right - left, _BAR)
    lines = wrap(
        f"{what_it_shows(design, side, seam_allowance)}; print at 100 %", max(int(width / (_LETTER * 3.2)), 12)
    )
    title = f"{design.name}: {side} face"
    head = top - _HEAD - _LINE * (len(lines) - 1)
    shapes: list[Shape] = [
        Words((left, head), title, size_within(title, width, 5), bold=True),
        *(Words((left, head + 6 + _LINE * k), line, 3.2) for k, line in enumerate(lines)),
        *face.shapes,
        *scale_bar((left, bottom + _FOOT - 4)),
    ]
    box = (left - _MARGIN, head - 4 - _MARGIN, max(right, left + _BAR) + _MARGIN, bottom + _FOOT + _MARGIN)
    return Drawing(tuple(shapes), box)


def what_it_shows(design: Design, side: str, seam_allowance: float) -> str:
    """Return in words which way the face is seen, the cloth's size, its seam allowance and what the numbers are."""
    seen = "as seen from behind (mirrored)" if side == "back" else "as seen from the front"
    cloth = f"cloth {in_mm(design.fabric.width):g} x {in_mm(design.fabric.height):g} mm"
    corner = "upper right" if side == "back" else "upper left"
    return f"{seen}; {cloth}, seam {in_mm(seam_allowance):g} mm; (u, v) in mm from the {corner} corner"


def _outlines(width: float, height: float, allowance: float) -> list[Shape]:
    """Return the edge of the finished cloth; where something is to be added for the seam, dashed, and the cut around
    it."""
    cloth = Line(_corners(0.0, width, height), 0.4, closed=True, dashed=allowance > 0)
    if allowance == 0:
        return [cloth]
    cut = Line(_corners(allowance, width, height), 0.4, closed=True)
    words = [Words((0.0, height + allowance - 1.2), f"cut here, {allowance:g} mm outside the cloth's edge", 2.6)]
    return [cut, cloth, *(words if allowance >= 4 else [])]


def _corners(around: float, width: float, height: float) -> tuple[Point, ...]:
    left, right, bottom = -around, width + around, height + around
    return ((left, left), (right, left), (right, bottom), (left, bottom))


def _seen(point: tuple[float, float], side: str, width: float) -> Point:
    """Return (u, v) m on the cloth as (right, down) mm on the page."""
    u, v = point
    return in_mm(width - u if side == "back" else u), in_mm(v)


def _hung(design: Design, side: str) -> list[Shape]:
    fabric = design.fabric
    width, height = in_mm(fabric.width), in_mm(fabric.height)
    if isinstance(fabric.hung, tuple):
        shapes: list[Shape] = []
        for x, y in (_seen(point, side, fabric.width) for point in fabric.hung):
            shapes += [Circle((x, y), 2.5, 0.3, fill="black"), Words((x + 3.5, y + 4), "hung here", 2.8)]
        return shapes
    mirrored = {"left": "right", "right": "left"}
    edge = mirrored.get(fabric.hung, fabric.hung) if side == "back" else fabric.hung
    edges: dict[str, tuple[Point, Point, Point, float]] = {  # both ends, the label's place and turn
        "top": ((0, 0), (width, 0), (width / 2, -1.8), 0),
        "bottom": ((0, height), (width, height), (width / 2, height - 1.8), 0),
        "left": ((0, 0), (0, height), (-1.8, height / 2), -90),
        "right": ((width, 0), (width, height), (width + 1.8, height / 2), 90),
    }
    if edge not in edges:
        return []
    start, end, place, turn = edges[edge]
    return [Line((start, end), 1.4), Words(place, "hung edge", 2.8, anchor="middle", turn=turn)]


def _muscle(muscle: Muscle, number: int, width: float) -> list[Shape]:
    colour = _COLOURS[muscle.channel % len(_COLOURS)]
    corners = tuple(_seen(point, muscle.side, width) for point in muscle.path)
    shapes: list[Shape] = [Line(corners, 0.6, colour)]
    for u, v in muscle.fixed_points():
        place = _seen((float(u), float(v)), muscle.side, width)
        shapes += [Circle(place, 1.2, 0.3, colour), *cross(place, 1.2, 0.2, colour)]
    text = f"{number} (channel {muscle.channel})"
    first, last = _place_words(muscle.path[0]), _place_words(muscle.path[-1])
    if in_mm(muscle.length) < _TWO_LABELS:
        shapes.append(_label(corners[0], corners[1], f"{text}: {first} to {last}", colour))
    else:  # at both ends, so that a page that shows one end alone says whose it is
        shapes.append(_label(corners[0], corners[1], f"{text}: {first}", colour))
        shapes.append(_label(corners[-1], corners[-2], f"{text}: {last}", colour))
    for place, (x, y) in zip(muscle.path[1:-1], corners[1:-1], strict=True):
        shapes.append(Words((x + 1.8, y + 3.2), _place_words(place), 2.2, colour))
    return shapes


def _place_words(place: tuple[float, float]) -> str:
    u, v = (round(in_mm(value), 1) for value in place)
    return f"({u:g}, {v:g})"


def _label(end: Point, towards: Point, text: str, colour: str) -> Words:
    """Return a label beside the line, from just inside its `end`: neighbours a few millimetres apart keep theirs apart
    too."""
    angle = degrees(atan2(towards[1] - end[1], towards[0] - end[0]))
    upright = -90 <= angle < 90  # else the words start at their far end, or they would stand on their heads
    turn = angle if upright else angle - 180 if angle > 0 else angle + 180
    along = 3.0 / max(dist(end, towards), 3.0)
    x, y = (a + along * (b - a) for a, b in zip(end, towards, strict=True))
    off = 2.2  # mm from the line, above the words' base line
    place = (x + off * sin(radians(turn)), y - off * cos(radians(turn)))
    return Words(place, text, 2.6, colour, anchor="start" if upright else "end", turn=turn)
