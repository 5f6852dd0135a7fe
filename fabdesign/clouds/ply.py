"""Strict PLY: ascii and binary, either byte order. What is short, long or odd is refused, never guessed.

Format: Greg Turk, The PLY Polygon File Format (1994).
"""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.measured_points import require_one_instant
from fabdesign.clouds.ply_body import Body, Element, PlyColumn, Property, refuse
from fabdesign.formats.bounded_file import read_bytes, require_few
from fabdesign.geometry.surface import fans_of
from fabdesign.output import whole_file

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 65536  # bytes
_END = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE)  # a line of its own: a comment may name it
_CORNERS = ("vertex_indices", "vertex_index")


class Ply(NamedTuple):
    points: NDArray[np.float64]  # (n, 3), in the file's unit
    triangles: NDArray[np.intp]  # (t, 3); polygons are cut into fans; (0, 3) for a cloud


def read_ply(path: Path | str) -> Ply:
    """Vertices and faces of a PLY. Raises InputError, with one line, for anything that is not exactly a sound file."""
    path = Path(path)
    content = read_bytes(path, "a PLY")
    order, elements, start = _header(content, path)
    body = Body(content[start:], order, path)
    points, corners = None, PlyColumn(np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp))
    for element in elements:
        require_few(element.count, path, f"{element.name} rows")
        columns = body.read(element)
        if element.name == "vertex":
            points = _points(columns, element, path)
        elif element.name == "face" and element.count:
            corners = next(columns[name] for name in _CORNERS if name in columns)
    body.finish()
    if points is None:
        refuse(path, "it has no vertices")
    if not np.all((np.abs(corners.values) < 2**31) & (corners.values == np.rint(corners.values))):
        refuse(path, "its faces are no lists of whole numbers")
    return Ply(points, fans_of(points, corners.values, corners.lengths, path))


def write_ply(path: Path | str, points: NDArray[np.floating], triangles: NDArray[np.integer] | None = None) -> None:
    """Write points (n, 3) as float32, and triangles (t, 3) where given, in binary little-endian. InputError where the
    file cannot be written."""
    with whole_file(Path(path)) as temporary:
        temporary.write_bytes(ply_bytes(points, triangles))


def ply_bytes(points: NDArray[np.floating], triangles: NDArray[np.integer] | None = None) -> bytes:
    """Return the content that `write_ply` writes."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    body = np.asarray(points, dtype="<f4").tobytes()
    if triangles is not None:
        header += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
        rows = np.empty(len(triangles), dtype=[("n", "u1"), ("corners", "<i4", 3)])
        rows["n"], rows["corners"] = 3, triangles
        body += rows.tobytes()
    return "\n".join([*header, "end_header\n"]).encode("ascii") + body


def _header(content: bytes, path: Path) -> tuple[str, list[Element], int]:
    """Byte order ('' for ascii), elements, and where the body starts."""
    end = _END.search(content, 0, _LONGEST_HEADER)
    if not content.startswith(b"ply") or end is None:
        refuse(path, "has no PLY header")
    lines = [line.split() for line in content[: end.start()].decode("latin-1").splitlines()]
    order: str | None = None
    elements: list[Element] = []
    for words in lines[1:]:
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in _ORDERS and order is None:
                order = _ORDERS[name]
            case ["element", name, count] if count.isdecimal():
                elements.append(Element(name, int(count[:18]), ()))
            case ["property", kind, name] if kind in _TYPES and elements:
                elements[-1] = _with(elements[-1], Property(name, _TYPES[kind]))
            case ["property", "list", n, kind, name] if (
                n in _TYPES and _TYPES[n][0] != "f" and kind in _TYPES and elements
            ):
                elements[-1] = _with(elements[-1], Property(name, _TYPES[kind], _TYPES[n]))
            case _:
                refuse(path, f'its header has the line "{" ".join(words)[:60]}"')
    if order is None:
        refuse(path, "its header names no format")
    if len({element.name for element in elements}) < len(elements):
        refuse(path, "its header has two elements of one name")
    for element in elements:
        names = [p.name for p in element.properties]
        if not names or len(set(names)) < len(names):
            refuse(path, f"its {element.name} has no properties, or two of one name")
        lists = [p.name for p in element.properties if p.count_kind is not None and p.name in _CORNERS]
        if (element.name == "face") != bool(lists) and element.count:  # else a mesh is taken for a cloud
            named = f"{element.name} rows with {lists[0]}" if lists else "face rows without vertex_indices"
            refuse(path, f"has {named}, which are not read")
    return order, elements, end.end()


def _with(element: Element, new: Property) -> Element:
    return Element(element.name, element.count, (*element.properties, new))


def _points(columns: dict[str, PlyColumn], element: Element, path: Path) -> NDArray[np.float64]:
    if not {"x", "y", "z"} <= columns.keys():
        refuse(path, "its vertices have no x, y, z")
    scalars = {p.name: columns[p.name].values for p in element.properties if p.count_kind is None}
    if not {"x", "y", "z"} <= scalars.keys():
        refuse(path, "its vertices have lists for x, y, z")
    require_one_instant(scalars, str(path))
    return np.stack([scalars[axis].astype(np.float64) for axis in "xyz"], axis=1)
