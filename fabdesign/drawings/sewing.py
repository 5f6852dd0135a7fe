"""Everything that a workshop needs to make a design: templates as SVG, PDF and DXF, and a cut list."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import count, takewhile
from pathlib import Path
from typing import ClassVar
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from fabdesign.drawings.pages import PAPERS, write_pages
from fabdesign.drawings.template import Drawing, laced_sides, template_sheet
from fabdesign.errors import InputError, note
from fabdesign.files.pressure_file import pressure_file_of, read_pressures, write_pressures
from fabdesign.formats.csv_table import write_rows
from fabdesign.nouns.design import Design
from fabdesign.output import Inputs, atomic_file, new_folder, write_text
from fabdesign.units import in_mm

COLUMNS = ["muscle", "type", "side", "channel", "laced_mm", "tail_mm", "cut_mm", "fixed_points"]
_LONGEST = {"seam allowance": 0.1, "tail length": 1.0}  # m; what is longer was surely meant in millimetres


def write_svg(drawing: Drawing, path: Path, *, title: str) -> None:
    """Write a drawing whose unit is the millimetre. Raises InputError where `path` cannot be written."""
    left, top, right, bottom = drawing.box
    size = {"width": f"{right - left:g}", "height": f"{bottom - top:g}"}
    head = {
        "xmlns": "http://www.w3.org/2000/svg",
        **{name: f"{length}mm" for name, length in size.items()},
        "viewBox": f"{left:g} {top:g} {' '.join(size.values())}",
        "font-family": "sans-serif",
    }
    svg = ET.Element("svg", head)
    ET.SubElement(svg, "title").text = title
    ET.SubElement(svg, "rect", {"x": f"{left:g}", "y": f"{top:g}", **size, "fill": "white"})
    svg.extend(shape.svg() for shape in drawing.shapes)
    ET.indent(svg)
    write_text(path, ET.tostring(svg, encoding="unicode", xml_declaration=False) + "\n")


def write_dxf(design: Design, path: Path, *, seam_allowance: float) -> None:
    """Write the cloth's edge (layer CLOTH), the line to cut (CUT, `seam_allowance` [m] outside it), muscle lines, fixed
    points and channel labels (layers FRONT and BACK).

    x right, y up, origin at the cloth's top left corner. Needs the extra `dxf` (ezdxf).
    """
    import ezdxf
    from ezdxf import units

    drawing = ezdxf.new(setup=True)
    drawing.units = units.MM
    for layer, colour in (("CUT", 3), ("CLOTH", 7), ("FRONT", 5), ("BACK", 1)):
        drawing.layers.add(layer, color=colour)
    space = drawing.modelspace()
    width, height = in_mm(design.fabric.width), in_mm(design.fabric.height)
    for layer, out in (("CUT", in_mm(seam_allowance)), ("CLOTH", 0.0)):
        right, bottom = width + out, -height - out
        corners = [(-out, out), (right, out), (right, bottom), (-out, bottom)]
        space.add_lwpolyline(corners, close=True, dxfattribs={"layer": layer})
    for number, muscle in enumerate(design.muscles):
        face = {"layer": muscle.side.upper()}
        space.add_lwpolyline([(in_mm(u), -in_mm(v)) for u, v in muscle.path], dxfattribs=face)
        for u, v in muscle.fixed_points():
            space.add_circle((in_mm(u), -in_mm(v)), radius=1.2, dxfattribs=face)
        u, v = muscle.path[0]
        label = space.add_text(f"{number} (channel {muscle.channel})", height=2.5, dxfattribs=face)
        label.set_placement((in_mm(u), -in_mm(v) + 2))
    with atomic_file(path) as unfinished:
        drawing.saveas(unfinished)


def write_cut_list(design: Design, path: Path, *, tail_length: float | None = None) -> None:
    """Write a row a muscle: its laced length, the tail at each end, the length to cut and the number of fixed points.

    tail_length: [m], in place of the muscle types' own. Raises InputError for a type in use that has none, and for a
    muscle that is longer than its type's stock.
    """
    rows = []
    for number, muscle in enumerate(design.muscles):
        kind = design.muscle_types[muscle.type]
        tail = kind.tail_length if tail_length is None else tail_length
        if tail is None:
            raise InputError(
                f"design {design.name}: muscle type {kind.name} has no tail_length, and a cut list without tails is "
                "too short; expected --tail-length, in m, what stays free at each end for tube and knot"
            )
        cut = muscle.length + 2 * tail
        if kind.stock_length is not None and cut > kind.stock_length:
            raise InputError(
                f"design {design.name}: muscle {number} needs {in_mm(cut):.1f} mm; "
                f"expected at most its stock, {in_mm(kind.stock_length):g} mm of {kind.name}"
            )
        lengths = (f"{in_mm(value):.1f}" for value in (muscle.length, tail, cut))
        rows.append((number, muscle.type, muscle.side, muscle.channel, *lengths, len(muscle.fixed_points())))
    write_rows(path, COLUMNS, rows)


def pressures_beside(design: Path) -> list[Path]:
    """Return the pressure files of a result's poses, where `design` lies in the folder of a search."""
    if not (design.parent / "result.json").is_file():
        return []
    return [*takewhile(Path.is_file, (design.parent / pressure_file_of(pose) for pose in count(1)))]


@dataclass(frozen=True)
class Exported:
    files: tuple[Path, ...]
    pressures: tuple[NDArray[np.float64], ...]  # (channels,) Pa of each pose, at the end of its program
    left_out: tuple[str, ...]  # what could not be made, and what would help
    json_keys: ClassVar = "files", ("pressures_kpa", "pressures"), "left_out"


@dataclass(frozen=True)
class Sewing:
    """How a design is sewn. paper: of the pages, "a4" or "letter"; None: no pages. seam_allowance: of cloth outside the
    cloth's edge [m]. tail_length: of a muscle, left free at each end [m], in place of the muscle types' own."""

    paper: str | None = "a4"
    seam_allowance: float = 0.01
    tail_length: float | None = None


def export_design(
    design: Design,
    folder: Path,
    sewing: Sewing = Sewing(),
    *,
    stem: str,
    pressures: Sequence[Path] = (),
    force: bool = False,
    inputs: Inputs = (),
) -> Exported:
    """Write the laced faces' templates as SVG, their pages as PDF, the cut list, the pressures and, where ezdxf is
    installed, a DXF.

    pressures: a file for each pose, written as `STEM_pressures.csv`, `STEM_pressures_2.csv`. force, inputs: as
    `new_folder` takes them.
    Raises InputError where a muscle type in use has no tail length, where a muscle is longer than its stock, for a
    length out of range, for too many pages, and like `new_folder`.
    """
    paper, seam_allowance, tail_length = sewing.paper, sewing.seam_allowance, sewing.tail_length
    if paper is not None and paper not in PAPERS:
        raise InputError(f"paper {paper}; expected one of {', '.join(PAPERS)}")
    for name, value in (("seam allowance", seam_allowance), ("tail length", tail_length)):
        if value is not None and not 0 <= value <= _LONGEST[name]:
            raise InputError(f"{name} = {value:g} m; expected 0 to {_LONGEST[name]:g} m")
    programs = [read_pressures(file, design) for file in pressures]
    left_out = []
    if not find_spec("ezdxf"):
        left_out.append("no DXF: pip install 'fabdesign[dxf]'")
        note(left_out[0])  # said before anything is written
    with new_folder(folder, made_by="export", force=force, inputs=inputs) as unfinished:
        write_cut_list(design, unfinished / f"{stem}_cut_list.csv", tail_length=tail_length)
        for pose, program in enumerate(programs, start=1):
            write_pressures(program, unfinished / f"{stem}_{pressure_file_of(pose)}")
        for side in laced_sides(design):
            drawing = template_sheet(design, side, seam_allowance=seam_allowance)
            write_svg(drawing, unfinished / f"{stem}_{side}.svg", title=f"{design.name}, {side}")
        if paper is not None:
            write_pages(design, unfinished / f"{stem}_{paper}.pdf", paper=paper, seam_allowance=seam_allowance)
        if not left_out:
            write_dxf(design, unfinished / f"{stem}.dxf", seam_allowance=seam_allowance)
        names = sorted(file.name for file in unfinished.iterdir())
    last = tuple(program.pressure[-1] for program in programs)
    return Exported(tuple(folder / name for name in names), last, tuple(left_out))
