"""A flat drawing in millimetres, x right and y down: what SVG and PDF pages are made of."""

from dataclasses import dataclass
from textwrap import wrap
from typing import Literal

Point = tuple[float, float]  # mm


@dataclass(frozen=True)
class Line:
    """Straight from point to point."""

    points: tuple[Point, ...]
    width: float  # mm
    colour: str = "black"
    closed: bool = False
    dashed: bool = False


@dataclass(frozen=True)
class Circle:
    centre: Point
    radius: float  # mm
    width: float  # mm, of its line
    colour: str = "black"
    fill: str = "white"


@dataclass(frozen=True)
class Words:
    at: Point  # on the base line
    text: str
    size: float  # mm
    colour: str = "black"
    anchor: Literal["start", "middle", "end"] = "start"
    turn: float = 0.0  # degrees, clockwise
    bold: bool = False


Shape = Line | Circle | Words


@dataclass(frozen=True)
class Drawing:
    """Shapes, in the order in which they are drawn, and the box (left, top, right, bottom) that holds them, mm."""

    shapes: tuple[Shape, ...]
    box: tuple[float, float, float, float]


def scale_bar(start: Point, length: float = 100.0) -> list[Shape]:
    """Return a bar to check a print by: ticks every 10 mm above the line, and what to measure below it."""
    x, y = start
    shapes: list[Shape] = [Line(((x, y), (x + length, y)), 0.4)]
    for i in range(round(length / 10) + 1):
        high = 4.0 if i % 5 == 0 else 2.0
        shapes.append(Line(((x + 10 * i, y), (x + 10 * i, y - high)), 0.3))
    return [*shapes, Words((x, y + 4.2), f"measure this: {length:g} mm", 3.2)]


_LETTER = 0.62  # of the size, a letter's width, wide ones and bold among them


def size_within(text: str, width: float, size: float) -> float:
    """Return the size [mm] of words, at most `size`, at which they fit a width [mm]."""
    return min(size, width / (_LETTER * max(len(text), 1)))


def lines_within(text: str, width: float, size: float) -> list[str]:
    """Return words of a size [mm] in lines that fit a width [mm]."""
    return wrap(text, max(int(width / (_LETTER * size)), 12))


def cross(centre: Point, size: float, width: float, colour: str) -> list[Shape]:
    """Return an upright cross, `size` from arm's end to arm's end."""
    (x, y), half = centre, size / 2
    return [
        Line(((x - half, y), (x + half, y)), width, colour),
        Line(((x, y - half), (x, y + half)), width, colour),
    ]
