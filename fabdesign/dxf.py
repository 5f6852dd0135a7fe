"""The layout as a DXF drawing in millimetres, a layer a face, as seen from the front."""

from pathlib import Path

from fabdesign.design import Design
from fabdesign.output import whole_file


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
    width, height = design.fabric.width * 1e3, design.fabric.height * 1e3
    for layer, out in (("CUT", seam_allowance * 1e3), ("CLOTH", 0.0)):
        right, bottom = width + out, -height - out
        corners = [(-out, out), (right, out), (right, bottom), (-out, bottom)]
        space.add_lwpolyline(corners, close=True, dxfattribs={"layer": layer})
    for number, muscle in enumerate(design.muscles):
        face = {"layer": muscle.side.upper()}
        space.add_lwpolyline([(u * 1e3, -v * 1e3) for u, v in muscle.path], dxfattribs=face)
        for u, v in muscle.fixed_points():
            space.add_circle((u * 1e3, -v * 1e3), radius=1.2, dxfattribs=face)
        u, v = muscle.path[0]
        label = space.add_text(f"{number} (channel {muscle.channel})", height=2.5, dxfattribs=face)
        label.set_placement((u * 1e3, -v * 1e3 + 2))
    with whole_file(path) as unfinished:
        drawing.saveas(unfinished)
