"""Strict OBJ: the vertices and faces of a Wavefront file; what cannot be read is refused, never skipped.

Format: Wavefront Technologies, Advanced Visualizer manual, appendix B1 (1992).
"""

from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError, note
from fabdesign.formats.bounded_file import MOST_POINTS, decode_any, read_bytes, require_few
from fabdesign.geometry.surface import fans_of

# statements that say nothing about where the surface is
_OTHER = {"vn", "vt", "vp", "g", "o", "s", "mg", "l", "p", "usemtl", "mtllib", "usemap", "maplib"}
_OTHER |= {"bevel", "c_interp", "d_interp", "lod"}
_LOOSE = 0.05  # share of the vertices that no face may use; more: the faces are cut short


def read_obj(path: Path | str) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return (n, 3) vertices in the file's unit, and (t, 3) triangles, polygons cut into fans; (0, 3) of a cloud.

    Raises InputError, with one line, for anything that is not a sound file.
    """
    path = Path(path)
    text = decode_any(read_bytes(path, "an OBJ mesh"), path).replace("\\\r\n", " ").replace("\\\n", " ")
    require_few(text.count("\n"), path, "lines")
    vertices: list[tuple[float, ...]] = []
    corners: list[int] = []  # of all faces
    lengths: list[int] = []  # of each face
    lines = weighted = False
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if not words or words[0] in _OTHER:
            lines |= words[:1] == ["l"]
            continue
        try:
            if words[0] == "v" and len(words) in (4, 5, 7, 8):  # with a weight, with a colour
                vertices.append(tuple(map(float, words[1:4])))
                weighted |= len(words) == 5 and float(words[4]) != 1
            elif words[0] == "f" and len(words) > 3:
                corners += [_corner(word, len(vertices)) for word in words[1:]]
                lengths.append(len(words) - 1)
            else:
                _refuse(path, number, line)
        except ValueError:
            _refuse(path, number, line)
    if weighted:
        raise InputError(f"{path}: has vertices whose weight is not 1: x, y, z may be meant divided by it; expected 1")
    if not vertices:
        raise InputError(f"{path}: has no vertices; expected a sound OBJ")
    if lines and not lengths:
        note(f"{path}: has lines and no faces; its {len(vertices)} vertices are taken")
    points = np.array(vertices)
    faces = fans_of(points, np.array(corners, dtype=np.intp), np.array(lengths, dtype=np.intp), path, first=1)
    loose = len(vertices) - len(np.unique(faces))
    if len(faces) and loose > _LOOSE * len(vertices):
        raise InputError(f"{path}: {loose} of {len(vertices)} vertices belong to no face; expected a whole mesh")
    return points, faces


def _corner(word: str, count: int) -> int:
    """Index from 0 of the vertex in `5`, `5/2/1`, `5//1` or `-1`. Raises ValueError."""
    index = int(word.split("/", 1)[0])
    index = index - 1 if index > 0 else count + index
    if not 0 <= index < MOST_POINTS or word.startswith(("0", "-0")):
        raise ValueError
    return index


def _refuse(path: Path, number: int, line: str) -> NoReturn:
    raise InputError(f'{path} line {number}: "{line.strip()[:60]}" is no whole vertex or face; expected a sound OBJ')
