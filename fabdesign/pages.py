"""A drawing on pages of a home printer, at 1:1: which part goes on which page, and what joins them."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil

from fabdesign.drawing import Circle, Drawing, Line, Point, Shape, Words, cross

PAPERS = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}  # mm, upright
NAMES = {"a4": "A4", "letter": "Letter"}
MARGIN = 11.0  # mm left and right, more than printers leave white
HEAD = 12.5  # mm above the window, for the title; printers leave 4 mm of it white
FOOT = 13.5  # mm below it, for the bar
OVERLAP = 10.0  # mm that neighbours share
_MARK = 5.0  # mm, a registration mark from end to end
_GREY = "#666666"

Box = tuple[float, float, float, float]  # left, top, right, bottom, mm


@dataclass(frozen=True)
class Tiling:
    """A drawing's box cut into rows and columns of windows that overlap; the windows' sizes are a page's."""

    box: Box
    page: tuple[float, float]  # mm
    rows: int
    columns: int

    @property
    def window(self) -> tuple[float, float]:
        """Width and height of what a page shows of the drawing, mm."""
        return window(self.page)

    def box_of(self, row: int, column: int) -> Box:
        """The part of the drawing that a page shows; all pages together have the drawing in their middle."""
        (width, height), (left, top, right, bottom) = self.window, self.box
        steps = (width - OVERLAP, height - OVERLAP)
        first = left + (right - left - OVERLAP - self.columns * steps[0]) / 2
        highest = top + (bottom - top - OVERLAP - self.rows * steps[1]) / 2
        x, y = first + column * steps[0], highest + row * steps[1]
        return x, y, x + width, y + height

    def pages(self) -> Iterator[tuple[int, int]]:
        return ((row, column) for row in range(self.rows) for column in range(self.columns))


def window(page: tuple[float, float]) -> tuple[float, float]:
    """Width and height [mm] that a page has for the drawing."""
    return page[0] - 2 * MARGIN, page[1] - HEAD - FOOT


def tiled(box: Box, paper: str) -> Tiling:
    """The fewest pages that hold a box, upright or, where that takes fewer, on their side."""
    upright = PAPERS[paper]
    return min((_tiling(box, page) for page in (upright, upright[::-1])), key=lambda t: t.rows * t.columns)


def _tiling(box: Box, page: tuple[float, float]) -> Tiling:
    columns, rows = (
        max(1, ceil((box[i + 2] - box[i] - OVERLAP) / (size - OVERLAP) - 1e-9)) for i, size in enumerate(window(page))
    )
    return Tiling(box, page, rows, columns)


def page_name(row: int, column: int) -> str:
    """A1, A2, ... in the first row, B1, ... in the second; AA after Z."""
    letters, rest = "", row + 1
    while rest:
        rest, letter = divmod(rest - 1, 26)
        letters = chr(ord("A") + letter) + letters
    return f"{letters}{column + 1}"


def joints(tiling: Tiling, row: int, column: int) -> tuple[list[Shape], list[Shape]]:
    """What joins a page to its neighbours, in the drawing's frame: shapes within the page's window, and crop marks in
    the margin around it.

    Neighbours meet on the middle line of what they share. The page to the right or below is cut along it, through
    two registration marks, and laid onto the other one.
    """
    left, top, right, bottom = tiling.box_of(row, column)
    inside: list[Shape] = []
    outside: list[Shape] = []
    half = OVERLAP / 2
    for there, x, neighbour, cut in (
        (column > 0, left + half, (row, column - 1), True),
        (column < tiling.columns - 1, right - half, (row, column + 1), False),
    ):
        if there:
            marks: list[Point] = [(x, top + share * (bottom - top)) for share in (0.25, 0.75)]
            words = _joint_words(page_name(*neighbour), cut)
            place = (x - 1.4 if cut else x + 3.4, top + 0.6 * (bottom - top))
            inside += _joint(((x, top), (x, bottom)), marks, Words(place, words, 2.4, _GREY, "middle", -90), cut=cut)
            outside += [Line(((x, top - 5), (x, top - 1)), 0.3), Line(((x, bottom + 1), (x, bottom + 5)), 0.3)]
    for there, y, neighbour, cut in (
        (row > 0, top + half, (row - 1, column), True),
        (row < tiling.rows - 1, bottom - half, (row + 1, column), False),
    ):
        if there:
            marks = [(left + share * (right - left), y) for share in (0.25, 0.75)]
            words = _joint_words(page_name(*neighbour), cut)
            place = (left + 0.6 * (right - left), y - 1.4 if cut else y + 3.4)
            inside += _joint(((left, y), (right, y)), marks, Words(place, words, 2.4, _GREY, "middle"), cut=cut)
            outside += [Line(((left - 5, y), (left - 1, y)), 0.3), Line(((right + 1, y), (right + 5, y)), 0.3)]
    return inside, outside


def _joint_words(neighbour: str, cut: bool) -> str:
    return f"cut off, and lay onto {neighbour}" if cut else f"{neighbour} lies on this"


def _joint(ends: tuple[Point, Point], marks: list[Point], words: Words, *, cut: bool) -> list[Shape]:
    shapes: list[Shape] = [Line(ends, 0.25, _GREY, dashed=not cut), words]
    for mark in marks:
        shapes += [*cross(mark, _MARK, 0.25, "black"), Circle(mark, _MARK / 4, 0.25, fill="none")]
    return shapes


def grid_drawing(face: Drawing, tiling: Tiling) -> Drawing:
    """The face with the outlines and names of its pages: how they lie together."""
    shapes: list[Shape] = []
    boxes = [tiling.box_of(row, column) for row, column in tiling.pages()]
    for (row, column), (left, top, right, bottom) in zip(tiling.pages(), boxes, strict=True):
        corners = ((left, top), (right, top), (right, bottom), (left, bottom))
        shapes.append(Line(corners, 0.8, _GREY, closed=True, dashed=True))
        size = min(right - left, bottom - top) / 8
        middle = ((left + right) / 2, (top + bottom) / 2 + size / 3)
        shapes.append(Words(middle, page_name(row, column), size, "#bbbbbb", "middle", bold=True))
    (left, top), (right, bottom) = boxes[0][:2], boxes[-1][2:]
    return Drawing((*shapes, *face.shapes), (left - 2, top - 2, right + 2, bottom + 2))
