"""A drawing on pages of a home printer, at 1:1: which part goes on which page, and what joins them."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil

from fabdesign.drawings.drawing import Circle, Drawing, Line, Point, Shape, Words, cross

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
        """Return the part of the drawing that a page shows; all pages together have the drawing in their middle."""
        (width, height), (left, top, right, bottom) = self.window, self.box
        steps = (width - OVERLAP, height - OVERLAP)
        first = left + (right - left - OVERLAP - self.columns * steps[0]) / 2
        highest = top + (bottom - top - OVERLAP - self.rows * steps[1]) / 2
        x, y = first + column * steps[0], highest + row * steps[1]
        return x, y, x + width, y + height

    def pages(self) -> Iterator[tuple[int, int]]:
        return ((row, column) for row in range(self.rows) for column in range(self.columns))


def window(page: tuple[float, float]) -> tuple[float, float]:
    """Return the width and height [mm] that a page has for the drawing."""
    return page[0] - 2 * MARGIN, page[1] - HEAD - FOOT


def tiled(box: Box, paper: str) -> Tiling:
    """Return the fewest pages that hold a box, upright or, where that takes fewer, on their side."""
    upright = PAPERS[paper]
    return min((_tiling(box, page) for page in (upright, upright[::-1])), key=lambda t: t.rows * t.columns)


def _tiling(box: Box, page: tuple[float, float]) -> Tiling:
    columns, rows = (
        max(1, ceil((box[i + 2] - box[i] - OVERLAP) / (size - OVERLAP) - 1e-9)) for i, size in enumerate(window(page))
    )
    return Tiling(box, page, rows, columns)


def page_name(row: int, column: int) -> str:
    """Return a page's name: A1, A2, ... in the first row, B1, ... in the second; AA after Z."""
    letters, rest = "", row + 1
    while rest:
        rest, letter = divmod(rest - 1, 26)
        letters = chr(ord("A") + letter) + letters
    return f"{letters}{column + 1}"


def joints(tiling: Tiling, row: int, column: int) -> tuple[list[Shape], list[Shape]]:
    """Return what joins a page to its neighbours, in the drawing's frame: shapes within the page's window, and crop
    marks in the margin around it.

    Neighbours meet on the middle line of what they share. The page to the right or below is cut along it, through
    two registration marks, and laid onto the other one.
    """
    box = tiling.box_of(row, column)
    inside: list[Shape] = []
    outside: list[Shape] = []

    def at(across: float, along: float, upright: bool) -> Point:
        return (across, along) if upright else (along, across)

    for upright, place, count in ((True, column, tiling.columns), (False, row, tiling.rows)):
        low, begin, high, end = box if upright else (box[1], box[0], box[3], box[2])
        for there, across, step in (
            (place > 0, low + OVERLAP / 2, -1),
            (place < count - 1, high - OVERLAP / 2, 1),
        ):
            if not there:
                continue
            cut = step < 0
            neighbour = page_name(row, column + step) if upright else page_name(row + step, column)
            words = f"cut off, and lay onto {neighbour}" if cut else f"{neighbour} lies on this"
            foot = at(across - 1.4 if cut else across + 3.4, begin + 0.6 * (end - begin), upright)
            inside.append(Line((at(across, begin, upright), at(across, end, upright)), 0.25, _GREY, dashed=not cut))
            inside.append(Words(foot, words, 2.4, _GREY, "middle", -90 if upright else 0))
            for share in (0.25, 0.75):
                mark = at(across, begin + share * (end - begin), upright)
                inside += [*cross(mark, _MARK, 0.25, "black"), Circle(mark, _MARK / 4, 0.25, fill="none")]
            for first, last in ((begin - 5, begin - 1), (end + 1, end + 5)):  # crop marks
                outside.append(Line((at(across, first, upright), at(across, last, upright)), 0.3))
    return inside, outside


def grid_drawing(face: Drawing, tiling: Tiling) -> Drawing:
    """Return the face with the outlines and names of its pages: how they lie together."""
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
