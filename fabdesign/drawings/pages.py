"""Sewing templates as a PDF for a home printer: an overview, then every face on pages at 1:1: which part goes on which
page, and what joins them."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any

from fabdesign.drawings.template import (
    Circle,
    Drawing,
    Line,
    Point,
    Shape,
    Words,
    cross,
    face_drawing,
    laced_sides,
    scale_bar,
    size_within,
    what_it_shows,
)
from fabdesign.errors import InputError
from fabdesign.nouns.design import Design
from fabdesign.output import atomic_file

PAPERS = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}  # mm, upright
NAMES = {"a4": "A4", "letter": "Letter"}
MARGIN = 11.0  # mm left and right, more than printers leave white
HEAD = 12.5  # mm above the window, for the title; printers leave 4 mm of it white
FOOT = 13.5  # mm below it, for the bar
OVERLAP = 10.0  # mm that neighbours share
_MARK = 5.0  # mm, a registration mark from end to end
_GREY = "#666666"

Box = tuple[float, float, float, float]  # left, top, right, bottom, mm
MOST_PAGES = 200
_MM = 1 / 25.4  # in
_POINT = 72 / 25.4  # points in a mm
_HOW = (
    "Print all pages at 100 % (actual size, not fitted to the page) and measure the bars: 100 mm each way.",
    "Cut each page along its left and upper joint line, where it has them, from crop mark to crop mark.",
    "Lay it onto its neighbour so that lines, crosses and half circles meet, and glue.",
)


@dataclass(frozen=True)
class Tiling:
    """A drawing's box cut into rows and columns of windows that overlap; the windows' sizes are a page's."""

    box: Box
    page: tuple[float, float]  # mm
    rows: int
    columns: int

    def box_of(self, row: int, column: int) -> Box:
        """Return the part of the drawing that a page shows; all pages together have the drawing in their middle."""
        (width, height), (left, top, right, bottom) = window(self.page), self.box
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
    tilings = []
    for page in (PAPERS[paper], PAPERS[paper][::-1]):
        lengths = zip((box[2] - box[0], box[3] - box[1]), window(page), strict=True)
        columns, rows = (max(1, ceil((length - OVERLAP) / (size - OVERLAP) - 1e-9)) for length, size in lengths)
        tilings.append(Tiling(box, page, rows, columns))
    return min(tilings, key=lambda tiling: tiling.rows * tiling.columns)


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


def write_pages(design: Design, path: Path, *, paper: str, seam_allowance: float) -> int:
    """Write the faces that have muscles (the front where none has) on `paper` (a key of PAPERS); the number of pages.

    seam_allowance: [m]. Raises InputError for a cloth that takes more than 200 pages and where `path` cannot be
    written.
    """
    sides = laced_sides(design)
    faces = [face_drawing(design, side, seam_allowance=seam_allowance) for side in sides]
    tilings = [tiled(face.box, paper) for face in faces]
    count = 1 + sum(tiling.rows * tiling.columns for tiling in tilings)
    if count > MOST_PAGES:
        size = f"{design.fabric.width:g} x {design.fabric.height:g} m"
        raise InputError(
            f"design {design.name}: {count} pages of {NAMES[paper]} for a cloth of {size}; "
            f"expected at most {MOST_PAGES}, or --paper none for whole templates alone"
        )
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import PdfPages

    with atomic_file(path) as unfinished, rc_context({"pdf.fonttype": 42}):  # words stay words
        about = {"Title": f"{design.name}, sewing template", "CreationDate": None}
        with PdfPages(unfinished, metadata=about) as pdf:
            pdf.savefig(overview_figure(design, list(zip(sides, faces, tilings, strict=True)), paper, count))
            number = 1
            for side, face, tiling in zip(sides, faces, tilings, strict=True):
                shown = what_it_shows(design, side, seam_allowance)
                for row, column in tiling.pages():
                    number += 1
                    title = f"{design.name}, {side} face: page {page_name(row, column)}"
                    foot = f"print at 100 % on {NAMES[paper]}; sheet {number} of {count}"
                    pdf.savefig(page_figure(face, tiling, row, column, (title, shown, foot)))
    return count


def page_figure(face: Drawing, tiling: Tiling, row: int, column: int, words: tuple[str, str, str]) -> Any:
    """Return one page with its part of a face. words: its title, what it shows, and what stands beside the bar."""
    figure = blank_figure(tiling.page)
    page, part = tiling.page, tiling.box_of(row, column)
    inside, outside = joints(tiling, row, column)
    within = page_axes(figure, page, (MARGIN, HEAD, page[0] - MARGIN, page[1] - FOOT), part)
    draw_shapes(within, [*face.shapes, *inside])
    # the whole page, in the drawing's frame
    page_box = (part[0] - MARGIN, part[1] - HEAD, part[2] + MARGIN, part[3] + FOOT)
    around = page_axes(figure, page, (0, 0, *page), page_box)
    left, top, right, bottom = part
    left += 8 if column else 0  # beside the crop mark
    title, shown = (size_within(text, right - left - 8, size) for text, size in zip(words, (4.0, 2.7), strict=False))
    heading = [Words((left, top - 5.6), words[0], title, bold=True), Words((left, top - 1.6), words[1], shown)]
    beside = Words((left + 104, bottom + 5), words[2], 2.7)
    draw_shapes(around, [*heading, *outside, *scale_bar((left, bottom + 5)), beside])
    return figure


def overview_figure(design: Design, faces: list[tuple[str, Drawing, Tiling]], paper: str, count: int) -> Any:
    """Return the first page: what to do, how the pages lie together, and a bar in each direction."""
    page = PAPERS[paper]
    figure = blank_figure(page)
    around = page_axes(figure, page, (0, 0, *page), (0, 0, *page))
    title = f"{design.name}: sewing template"
    size = size_within(title, page[0] - 2 * MARGIN, 6)
    shapes: list[Shape] = [Words((MARGIN, 18), title, size, bold=True)]
    shapes.append(Words((MARGIN, 25), f"{count} sheets of {NAMES[paper]}, this one included", 3.2))
    shapes += [Words((MARGIN, 33 + 5 * i), f"{i + 1}. {line}", 3.2) for i, line in enumerate(_HOW)]
    low = page[1] - 18.0
    shapes += scale_bar((MARGIN + 12, low))
    shapes += scale_bar((MARGIN + 4, low), upright=True)
    draw_shapes(around, shapes)
    top, left, right = 56.0, MARGIN + 14, page[0] - MARGIN
    each = (low - 12 - top) / len(faces)
    for i, (side, face, tiling) in enumerate(faces):
        laid = grid_drawing(face, tiling)
        x0, y0, x1, y1 = laid.box
        room = (right - left, each - 10)
        scale = min(room[0] / (x1 - x0), room[1] / (y1 - y0))
        head = top + i * each
        names = f"{page_name(0, 0)} to {page_name(tiling.rows - 1, tiling.columns - 1)}"
        words = f"{side} face, pages {names}" if tiling.rows * tiling.columns > 1 else f"{side} face, page {names[:2]}"
        draw_shapes(around, [Words((left, head), words, 3.6, bold=True)])
        place = (left, head + 3, left + scale * (x1 - x0), head + 3 + scale * (y1 - y0))
        draw_shapes(page_axes(figure, page, place, laid.box), laid.shapes, scale)
    return figure


def blank_figure(page: tuple[float, float]) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(page[0] * _MM, page[1] * _MM))


def page_axes(figure: Any, page: tuple[float, float], place: Box, box: Box) -> Any:
    """Return a window at `place` on the page onto `box` of a drawing."""
    left, top, right, bottom = place
    share = (left / page[0], 1 - bottom / page[1], (right - left) / page[0], (bottom - top) / page[1])
    axes = figure.add_axes(share, xlim=(box[0], box[2]), ylim=(box[3], box[1]))
    axes.set_axis_off()
    return axes


def draw_shapes(axes: Any, shapes: Iterable[Shape], scale: float = 1.0) -> None:
    """Draw shapes in their order. scale: page millimetres to a unit of the drawing."""
    for order, shape in enumerate(shapes):
        shape.draw(axes, scale * _POINT, order)
