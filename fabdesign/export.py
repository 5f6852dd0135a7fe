"""Everything that a workshop needs to make a design."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from fabdesign.cut_list import write_cut_list
from fabdesign.design import Design
from fabdesign.dxf import write_dxf
from fabdesign.errors import InputError
from fabdesign.output import Inputs, new_folder
from fabdesign.pages import PAPERS
from fabdesign.pdf import write_pages
from fabdesign.svg import write_svg
from fabdesign.template import whole_template

_LONGEST = {"seam allowance": 0.1, "tail length": 1.0}  # m; what is longer was surely meant in millimetres


@dataclass(frozen=True)
class Exported:
    files: tuple[Path, ...]
    left_out: tuple[str, ...]  # what could not be made, and what would help


def export_design(
    design: Design,
    folder: Path,
    *,
    stem: str,
    paper: str | None = "a4",
    seam_allowance: float = 0.01,
    tail_length: float | None = None,
    force: bool = False,
    inputs: Inputs = (),
) -> Exported:
    """Write both faces' templates as SVG, their pages as PDF, the cut list and, where ezdxf is installed, a DXF.

    paper: "a4" or "letter"; None: no pages. seam_allowance: of cloth outside the cloth's edge [m]. tail_length: of a
    muscle, left free at each end [m], in place of the muscle types' own. force, inputs: as `new_folder` takes them.
    Raises InputError where a muscle type in use has no tail length, where a muscle is longer than its stock, for a
    length out of range, for too many pages, and like `new_folder`.
    """
    if paper is not None and paper not in PAPERS:
        raise InputError(f"paper {paper}; expected one of {', '.join(PAPERS)}")
    for name, value in (("seam allowance", seam_allowance), ("tail length", tail_length)):
        if value is not None and not 0 <= value <= _LONGEST[name]:
            raise InputError(f"{name} = {value:g} m; expected 0 to {_LONGEST[name]:g} m")
    left_out = []
    with new_folder(folder, made_by="export", force=force, inputs=inputs) as unfinished:
        write_cut_list(design, unfinished / f"{stem}_cut_list.csv", tail_length=tail_length)
        for side in ("front", "back"):
            drawing = whole_template(design, side, seam_allowance=seam_allowance)
            write_svg(drawing, unfinished / f"{stem}_{side}.svg", title=f"{design.name}, {side}")
        if paper is not None:
            write_pages(design, unfinished / f"{stem}_{paper}.pdf", paper=paper, seam_allowance=seam_allowance)
        if find_spec("ezdxf"):
            write_dxf(design, unfinished / f"{stem}.dxf", seam_allowance=seam_allowance)
        else:
            left_out.append("no DXF: pip install 'fabdesign[dxf]'")
        names = sorted(file.name for file in unfinished.iterdir())
    return Exported(tuple(folder / name for name in names), tuple(left_out))
