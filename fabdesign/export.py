"""Everything that a workshop needs to make a design."""

from importlib.util import find_spec
from pathlib import Path

from fabdesign.cut_list import write_cut_list
from fabdesign.design import Design
from fabdesign.dxf import write_dxf
from fabdesign.output import new_folder
from fabdesign.template import write_template


def export_design(design: Design, folder: Path, *, stem: str) -> list[Path]:
    """Write the templates of both faces, the cut list and, where ezdxf is installed, a DXF; the files written.

    Raises InputError where the folder cannot be written and where a muscle is longer than its stock.
    """
    with new_folder(folder) as unfinished:
        for side in ("front", "back"):
            write_template(design, side, unfinished / f"{stem}_{side}.svg")
        write_cut_list(design, unfinished / f"{stem}_cut_list.csv")
        if find_spec("ezdxf"):
            write_dxf(design, unfinished / f"{stem}.dxf")
        names = sorted(file.name for file in unfinished.iterdir())
    return [folder / name for name in names]
