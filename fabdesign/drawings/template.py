"""Sewing templates: what is to be cut, hung and laced, a face of the design in millimetres as that face is seen."""

from math import atan2, cos, degrees, dist, radians, sin

from fabdesign.drawings.drawing import (
    Circle,
    Drawing,
    Line,
    Point,
    Shape,
    Words,
    cross,
    lines_within,
    scale_bar,
    size_within,
)
from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from fabdesign.units import in_mm

_MARGIN = 15.0  # mm around the cloth that is cut
_HEAD = 12.0  # mm above it, for the title
_LINE = 4.4  # mm, of its further lines
_FOOT = 18.0  # mm below it, for the bar
_BAR = 100.0  # mm
_TWO_LABELS = 60.0  # mm: a muscle as long as this is labelled at both ends
# Okabe and Ito's colours: they differ for colour-blind people too
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8a7a00")


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


def whole_template(design: Design, side: str, *, seam_allowance: float) -> Drawing:
    """Return a face with its title and a bar of 100 mm to check the print by, on one sheet."""
    face = face_drawing(design, side, seam_allowance=seam_allowance)
    left, top, right, bottom = face.box
    width = max(right - left, _BAR)
    lines = lines_within(f"{what_it_shows(design, side, seam_allowance)}; print at 100 %", width, 3.2)
    title = f"{design.name}: {side} face"
    head = top - _HEAD - _LINE * (len(lines) - 1)
    shapes: list[Shape] = [
        Words((left, head), title, size_within(title, width, 5), bold=True),
        *(Words((left, head + 6 + _LINE * k), line, 3.2) for k, line in enumerate(lines)),
        *face.shapes,
        *scale_bar((left, bottom + _FOOT - 4), _BAR),
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
