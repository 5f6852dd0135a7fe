"""Sewing templates: a face of the design at 1:1, as SVG in millimetres."""

from pathlib import Path
from xml.etree import ElementTree as ET

from fabdesign.design import Design
from fabdesign.muscle import Muscle
from fabdesign.output import write_text

_MARGIN = 15.0  # mm around the cloth
_FOOT = 22.0  # mm below it, for the calibration bar
_HEAD = 12.0  # mm above it, for the title
_BAR = 50.0  # mm
# Okabe and Ito's colours: they differ for colour-blind people too
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8a7a00")


def write_template(design: Design, side: str, path: Path) -> None:
    """Write the template of one face ("front" or "back") as that face is seen, so the back is mirrored.

    It shows the cloth's outline and hung edge, each muscle's line, its fixed points and channel, and a 50 mm bar to
    check the print by. Raises InputError where `path` cannot be written.
    """
    fabric = design.fabric
    width, height = fabric.width * 1e3, fabric.height * 1e3
    page = (width + 2 * _MARGIN, height + 2 * _MARGIN + _HEAD + _FOOT)
    svg = ET.Element(
        "svg",
        {
            "xmlns": "http://www.w3.org/2000/svg",
            "width": f"{page[0]:g}mm",
            "height": f"{page[1]:g}mm",
            "viewBox": f"0 0 {page[0]:g} {page[1]:g}",
            "font-family": "sans-serif",
        },
    )
    ET.SubElement(svg, "title").text = f"{design.name}, {side}"
    ET.SubElement(svg, "rect", {"width": "100%", "height": "100%", "fill": "white"})
    seen = "as seen from behind (mirrored)" if side == "back" else "as seen from the front"
    _text(svg, _MARGIN, _MARGIN - 2, f"{design.name}: {side} face", 5, bold=True)
    _text(svg, _MARGIN, _MARGIN + 4, f"{seen}; cloth {width:g} x {height:g} mm; print at 100 %", 3.2)
    cloth = ET.SubElement(svg, "g", {"transform": f"translate({_MARGIN:g} {_MARGIN + _HEAD:g})"})
    _outline(cloth, design, side, width, height)
    for number, muscle in enumerate(design.muscles, start=1):
        if muscle.side == side:
            _muscle(cloth, muscle, number, fabric.width)
    _calibration_bar(svg, _MARGIN, page[1] - _MARGIN)
    ET.indent(svg)
    write_text(path, ET.tostring(svg, encoding="unicode", xml_declaration=False) + "\n")


def _seen(point: tuple[float, float], side: str, width: float) -> tuple[float, float]:
    """(u, v) m on the cloth as (right, down) mm on the page."""
    u, v = point
    return (width - u if side == "back" else u) * 1e3, v * 1e3


def _outline(group: ET.Element, design: Design, side: str, width: float, height: float) -> None:
    box = {"width": f"{width:g}", "height": f"{height:g}"}
    ET.SubElement(group, "rect", {**box, "fill": "none", "stroke": "black", "stroke-width": "0.4"})
    hung = design.fabric.hung
    if isinstance(hung, tuple):
        for point in hung:
            x, y = _seen(point, side, design.fabric.width)
            ET.SubElement(group, "circle", {"cx": f"{x:g}", "cy": f"{y:g}", "r": "2.5", "fill": "black"})
            _text(group, x + 3, y + 4, "hung here", 2.8)
        return
    mirrored = {"left": "right", "right": "left"}
    edge = mirrored.get(hung, hung) if side == "back" else hung
    ends = {
        "top": (0.0, 0.0, width, 0.0),
        "bottom": (0.0, height, width, height),
        "left": (0.0, 0.0, 0.0, height),
        "right": (width, 0.0, width, height),
    }
    if edge in ends:
        x1, y1, x2, y2 = ends[edge]
        _line(group, x1, y1, x2, y2, "black", 1.4)
        label = _text(group, 0, 0, "hung edge", 2.8)
        label.set("text-anchor", "middle")
        turn = {"bottom": "translate({0} {2})", "left": "translate(-2 {1}) rotate(-90)"}
        turn |= {"top": "translate({0} -1.5)", "right": "translate({3} {1}) rotate(90)"}
        label.set("transform", turn[edge].format(width / 2, height / 2, height + 4, width + 2))


def _muscle(group: ET.Element, muscle: Muscle, number: int, width: float) -> None:
    colour = _COLOURS[muscle.channel % len(_COLOURS)]
    corners = [_seen(point, muscle.side, width) for point in muscle.path]
    ET.SubElement(
        group,
        "polyline",
        {
            "points": " ".join(f"{x:.3f},{y:.3f}" for x, y in corners),
            "fill": "none",
            "stroke": colour,
            "stroke-width": "0.6",
        },
    )
    for u, v in muscle.fixed_points():
        x, y = _seen((float(u), float(v)), muscle.side, width)
        attributes = {"cx": f"{x:.3f}", "cy": f"{y:.3f}", "r": "1.2", "fill": "white", "stroke": colour}
        ET.SubElement(group, "circle", {**attributes, "stroke-width": "0.3"})
        _line(group, x - 0.6, y, x + 0.6, y, colour, 0.2)
        _line(group, x, y - 0.6, x, y + 0.6, colour, 0.2)
    x, y = corners[0]
    x = min(max(x, 10.0), max(width * 1e3 - 10.0, 10.0))  # the label stays on the cloth
    label = _text(group, x, y - 2.2, f"{number} (channel {muscle.channel})", 2.6, colour=colour)
    label.set("text-anchor", "middle")


def _calibration_bar(svg: ET.Element, x: float, y: float) -> None:
    _line(svg, x, y, x + _BAR, y, "black", 0.5)
    for millimetres in range(0, int(_BAR) + 1, 10):
        long = millimetres in (0, int(_BAR))
        _line(svg, x + millimetres, y - (4 if long else 2), x + millimetres, y, "black", 0.3)
    _text(svg, x, y + 5, "this bar is 50 mm long on a true print", 3.2)


def _line(parent: ET.Element, x1: float, y1: float, x2: float, y2: float, colour: str, width: float) -> None:
    ends = {"x1": f"{x1:.3f}", "y1": f"{y1:.3f}", "x2": f"{x2:.3f}", "y2": f"{y2:.3f}"}
    ET.SubElement(parent, "line", {**ends, "stroke": colour, "stroke-width": f"{width:g}"})


def _text(
    parent: ET.Element, x: float, y: float, words: str, size: float, *, bold: bool = False, colour: str = "black"
) -> ET.Element:
    style = {"x": f"{x:.3f}", "y": f"{y:.3f}", "font-size": f"{size:g}", "fill": colour}
    element = ET.SubElement(parent, "text", {**style, **({"font-weight": "bold"} if bold else {})})
    element.text = words
    return element
