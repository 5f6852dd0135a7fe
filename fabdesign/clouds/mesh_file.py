"""Meshes that trimesh reads: STL, OFF, GLB and glTF. What must hold is checked before and after: trimesh takes a file
that is cut short for a smaller one, and skips what it does not know."""

import io
import logging
import re
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.gltf_file import require_plain
from fabdesign.errors import InputError
from fabdesign.formats.bounded_file import LARGEST, read_bytes
from fabdesign.geometry.surface import fans_of

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # else it prints the stacks of what it tries
KINDS = (".stl", ".off", ".glb", ".gltf")
_START, _FACET_SIZE = 84, 50  # bytes of a binary STL's header and count, and of a facet
_NAME_LINES = re.compile(rb"^[ \t]*(end)?solid\b[^\r\n]*", re.MULTILINE | re.IGNORECASE)
_FACET = re.compile(
    rb"facet\s+normal(?:\s+\S+){3}\s+outer\s+loop(?:\s+vertex(?:\s+\S+){3}){3}\s+endloop\s+endfacet(?!\S)",
    re.IGNORECASE,
)


def read_mesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return (n, 3) vertices in the file's unit and (t, 3) triangles, polygons cut into fans.

    Raises InputError, with one line, for anything that is not a sound file.
    """
    kind = path.suffix.lower()
    content = read_bytes(path, "a mesh", largest=LARGEST if kind == ".stl" else LARGEST // 10)  # others are packed
    number, faces, bare = None, None, {}
    if kind == ".stl":
        content, number = _stl(content, path)
    elif kind == ".off":
        faces = _faces_of_off(content, path)
        number = int((faces[1] - 2).sum())
    else:
        require_plain(content, path)
        bare = {"skip_materials": True}  # whose pictures may be any files
    import trimesh

    beside = trimesh.resolvers.FilePathResolver(str(path))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # by which numpy says that a text's numbers end early
            mesh = trimesh.load(io.BytesIO(content), kind[1:], resolver=beside, force="mesh", process=False, **bare)
        vertices, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.intp)
    except Exception as error:  # trimesh raises whatever its parsers meet
        why = "a facet has a word where a number should be" if kind == ".stl" else "cannot be read as a mesh"
        raise _bad(path, f"{why} ({type(error).__name__})") from None
    if not len(triangles) and not number:
        raise InputError(f"{path}: has no triangles; expected a mesh")
    if number is not None and len(triangles) != number:
        raise _bad(path, f"has {number} triangles, of which {len(triangles)} can be read")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise _bad(path, f"a face names vertex {triangles.max()} of {len(vertices)}")
    if faces is not None:
        fans_of(vertices, *faces, path)  # whether they are what trimesh makes of them
    return vertices, triangles


def _stl(content: bytes, path: Path) -> tuple[bytes, int]:
    """Return the content, of an ascii file without names, which trimesh may take for facets, and the facets' number."""
    count = int.from_bytes(content[80:_START], "little")
    size = _START + count * _FACET_SIZE
    if len(content) >= _START and len(content) == size:
        return content, count
    if content[:5].lower() != b"solid":
        needed = "a header has 84" if len(content) < _START else f"its {count} facets need {size}"
        raise _bad(path, f"has {len(content)} bytes; {needed}")
    names = [bool(match[1]) for match in _NAME_LINES.finditer(content)]
    if names[::2] != [False] * (len(names) // 2) or names[1::2] != [True] * (len(names) // 2):
        raise _bad(path, "is cut short: a solid has no end" if names[-1:] == [False] else "its solids do not pair")
    bare = _NAME_LINES.sub(lambda match: (match[1] or b"") + b"solid", content)
    between = _FACET.split(bare)
    odd = next((i for i, text in enumerate(between) if set(text.lower().split()) - {b"solid", b"endsolid"}), None)
    if odd is not None:
        raise _bad(path, f"facet {odd} is not whole")
    return bare, len(between) - 1


def _faces_of_off(content: bytes, path: Path) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the corners of all faces of an OFF, one face after another, and how many each has."""
    lines = [line for line in re.sub(rb"#[^\r\n]*", b"", content).splitlines() if line.strip()]
    head = re.sub(rb"^\s*C?N?OFF\b", b"", lines[0]).split() if lines else []
    if not head and len(lines) > 1:
        head, lines = lines[1].split(), lines[1:]
    if len(head) < 2 or not all(number.isdigit() and len(number) < 10 for number in head[:2]):
        raise _bad(path, "cannot be read as a mesh (no counts in its first lines)")
    vertices, faces = int(head[0]), int(head[1])
    if len(lines) - 1 != vertices + faces:
        raise _bad(path, f"has {len(lines) - 1} rows; its header says {vertices} vertices and {faces} faces")
    rows = [line.split() for line in lines[1 + vertices :]]
    if any(not row[0].isdigit() or not 3 <= int(row[0][:9]) < len(row) for row in rows):
        raise _bad(path, "a face is not whole")
    lengths = np.array([int(row[0]) for row in rows], dtype=np.intp)
    words = [word for row in rows for word in row[1 : 1 + int(row[0])]]
    if not all(word.isdigit() and len(word) < 10 for word in words):
        raise _bad(path, "a face names no vertex")
    return np.array([*map(int, words)], dtype=np.intp), lengths


def _bad(path: Path, why: str) -> InputError:
    return InputError(f"{path}: {why}; expected a sound {path.suffix[1:].upper()}")
