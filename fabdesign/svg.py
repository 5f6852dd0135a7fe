"""A drawing as SVG at 1:1."""

from pathlib import Path
from xml.etree import ElementTree as ET

from fabdesign.drawing import Circle, Drawing, Line, Shape
from fabdesign.output import write_text


def write_svg(drawing: Drawing, path: Path, *, title: str) -> None:
    """Write a drawing whose unit is the millimetre. Raises InputError where `path` cannot be written."""
    left, top, right, bottom = drawing.box
    width, height = right - left, bottom - top
    svg = ET.Element(
        "svg",
        {
            "xmlns": "http://www.w3.org/2000/svg",
            "width": f"{width:g}mm",
            "height": f"{height:g}mm",
            "viewBox": f"{left:g} {top:g} {width:g} {height:g}",
            "font-family": "sans-serif",
        },
    )
    ET.SubElement(svg, "title").text = title
    paper = {"x": f"{left:g}", "y": f"{top:g}", "width": f"{width:g}", "height": f"{height:g}", "fill": "white"}
    ET.SubElement(svg, "rect", paper)
    for shape in drawing.shapes:
        _add(svg, shape)
    ET.indent(svg)
    write_text(path, ET.tostring(svg, encoding="unicode", xml_declaration=False) + "\n")


def _add(svg: ET.Element, shape: Shape) -> None:
    if isinstance(shape, Line):
        style = {"fill": "none", "stroke": shape.colour, "stroke-width": f"{shape.width:g}"}
        if shape.dashed:
            style["stroke-dasharray"] = "3 2"
        points = " ".join(f"{x:.3f},{y:.3f}" for x, y in shape.points)
        ET.SubElement(svg, "polygon" if shape.closed else "polyline", {"points": points, **style})
    elif isinstance(shape, Circle):
        place = {"cx": f"{shape.centre[0]:.3f}", "cy": f"{shape.centre[1]:.3f}", "r": f"{shape.radius:g}"}
        style = {"fill": shape.fill, "stroke": shape.colour, "stroke-width": f"{shape.width:g}"}
        ET.SubElement(svg, "circle", place | style)
    else:
        x, y = (f"{value:.3f}" for value in shape.at)
        style = {"x": x, "y": y, "font-size": f"{shape.size:g}", "fill": shape.colour, "text-anchor": shape.anchor}
        if shape.turn:
            style["transform"] = f"rotate({shape.turn:g} {x} {y})"
        if shape.bold:
            style["font-weight"] = "bold"
        ET.SubElement(svg, "text", style).text = shape.text
