"""Meshes: OBJ, STL and OFF, read strictly, and glTF and GLB, which trimesh reads: what it would miss is refused before.

Formats: Wavefront Technologies, Advanced Visualizer manual, appendix B1 (1992), whose statements that are none are
refused and never skipped; 3D Systems, Stereolithography interface specification (1988); Geomview manual, OFF; Khronos,
glTF 2.0.
"""

import io
import json
import logging
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.measured_points import refuse
from fabdesign.errors import InputError, note
from fabdesign.formats.toml_file import LARGEST, MOST_POINTS, decode_any, parsing, read_bytes, require_count
from fabdesign.geometry.surface import fans_of

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # else it prints the stacks of what it tries
Mesh = tuple[NDArray[np.float64], NDArray[np.intp]]

# statements of an OBJ that say nothing about where the surface is
_OTHER = {"vn", "vt", "vp", "g", "o", "s", "mg", "l", "p", "usemtl", "mtllib", "usemap", "maplib"}
_OTHER |= {"bevel", "c_interp", "d_interp", "lod"}
_LOOSE = 0.05  # share of an OBJ's vertices that no face may use; more: the faces are cut short
_START = 84  # bytes of a binary STL's header and count
_BINARY_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", 9), ("attribute", "<u2")])
_NAME_LINES = re.compile(rb"^[ \t]*(end)?solid\b[^\r\n]*", re.MULTILINE | re.IGNORECASE)
_FACET = re.compile(
    rb"facet\s+normal(?:\s+\S+){3}\s+outer\s+loop(?:\s+vertex(?:\s+\S+){3}){3}\s+endloop\s+endfacet(?!\S)",
    re.IGNORECASE,
)
_VERTEX = re.compile(rb"\svertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
_FLOAT32, _TRIANGLES = 5126, 4  # of a glTF
_MODES = range(6)  # points, lines, triangles and their strips; trimesh leaves out fans in silence
_COMPRESSED, _INSTANCES = "KHR_draco_mesh_compression", "EXT_mesh_gpu_instancing"
_PLAIN = "a sound glTF of plain triangles"


def read_mesh(path: Path) -> Mesh:
    """Return (n, 3) vertices in the file's unit and (t, 3) triangles, polygons cut into fans; (0, 3) of a cloud.

    Raises InputError, with one line, for anything that is not a sound file.
    """
    kind = path.suffix.lower()
    packed = kind not in (".obj", ".stl")
    what = "an OBJ mesh" if kind == ".obj" else "a mesh"
    content = read_bytes(path, what, largest=LARGEST // 10 if packed else LARGEST)
    if kind == ".obj":
        return _obj(content, path)
    vertices, triangles = {".stl": _stl, ".off": _off}.get(kind, _gltf)(content, path)
    if not len(triangles):
        raise InputError(f"{path}: has no triangles; expected a mesh")
    return vertices, triangles


def _obj(content: bytes, path: Path) -> Mesh:
    text = decode_any(content, path).replace("\\\r\n", " ").replace("\\\n", " ")
    require_count(text.count("\n"), path, "lines")
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
                raise ValueError
        except ValueError:
            shown = f'"{line.strip()[:60]}"'
            raise InputError(
                f"{path} line {number}: {shown} is no whole vertex or face; expected a sound OBJ"
            ) from None
    if weighted:
        raise InputError(f"{path}: has vertices whose weight is not 1: x, y, z may be meant divided by it; expected 1")
    if not vertices:
        refuse(path, "has no vertices")
    if lines and not lengths:
        note(f"{path}: has lines and no faces; its {len(vertices)} vertices are taken")
    points = np.array(vertices)
    faces = fans_of(points, np.array(corners, dtype=np.intp), np.array(lengths, dtype=np.intp), path, first=1)
    loose = len(vertices) - len(np.unique(faces))
    if len(faces) and loose > _LOOSE * len(vertices):
        raise InputError(f"{path}: {loose} of {len(vertices)} vertices belong to no face; expected a whole mesh")
    return points, faces


def _corner(word: str, count: int) -> int:
    """Return the index from 0 of the vertex in `5`, `5/2/1`, `5//1` or `-1`. Raises ValueError."""
    index = int(word.split("/", 1)[0])
    index = index - 1 if index > 0 else count + index
    if not 0 <= index < MOST_POINTS or word.startswith(("0", "-0")):
        raise ValueError
    return index


def _stl(content: bytes, path: Path) -> Mesh:
    count = int.from_bytes(content[80:_START], "little")
    size = _START + count * _BINARY_FACET.itemsize
    if len(content) >= _START and len(content) == size:
        vertices = np.frombuffer(content, _BINARY_FACET, count, _START)["corners"].astype(np.float64)
    elif content[:5].lower() != b"solid":
        needed = "a header has 84" if len(content) < _START else f"its {count} facets need {size}"
        refuse(path, f"has {len(content)} bytes; {needed}")
    else:
        names = [bool(match[1]) for match in _NAME_LINES.finditer(content)]
        if names[::2] != [False] * (len(names) // 2) or names[1::2] != [True] * (len(names) // 2):
            cut = names[-1:] == [False]
            refuse(path, "is cut short: a solid has no end" if cut else "its solids do not pair")
        bare = _NAME_LINES.sub(b" ", content)  # names may look like facets
        odd = next((i for i, between in enumerate(_FACET.split(bare)) if between.strip()), None)
        if odd is not None:
            refuse(path, f"facet {odd} is not whole")
        words = [word for corner in _VERTEX.findall(bare) for word in corner]
        vertices = _numbers(words, path, "a facet has a word where a number should be")
    vertices = vertices.reshape(-1, 3)
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def _numbers(words: list[bytes], path: Path, why: str) -> NDArray[np.float64]:
    """Return the numbers that words say. Raises InputError where one is none."""
    with parsing(path, f"{why} ({{}})", f"a sound {path.suffix[1:].upper()}"):
        return np.array([float(word.replace(b"_", b"?")) for word in words])  # Python takes 1_000 for a number


def _off(content: bytes, path: Path) -> Mesh:
    lines = [line for line in re.sub(rb"#[^\r\n]*", b"", content).splitlines() if line.strip()]
    head = re.sub(rb"^\s*C?N?OFF\b", b"", lines[0]).split() if lines else []
    if not head and len(lines) > 1:
        head, lines = lines[1].split(), lines[1:]
    if len(head) < 2 or not all(number.isdigit() and len(number) < 10 for number in head[:2]):
        refuse(path, "cannot be read as a mesh (no counts in its first lines)")
    count, faces = int(head[0]), int(head[1])
    if len(lines) - 1 != count + faces:
        refuse(path, f"has {len(lines) - 1} rows; its header says {count} vertices and {faces} faces")
    rows = [line.split() for line in lines[1:]]
    if any(not row[0].isdigit() or not 3 <= int(row[0][:9]) < len(row) for row in rows[count:]):
        refuse(path, "a face is not whole")
    corners = [word for row in rows[count:] for word in row[1 : 1 + int(row[0])]]
    if not all(word.isdigit() and len(word) < 10 for word in corners):
        refuse(path, "a face names no vertex")
    if any(len(row) < 3 for row in rows[:count]) or max(map(int, corners), default=0) >= count:
        refuse(path, "cannot be read as a mesh (a vertex is not whole, or a face names another one)")
    coordinates = [word for row in rows[:count] for word in row[:3]]
    vertices = _numbers(coordinates, path, "cannot be read as a mesh").reshape(-1, 3)
    lengths = np.array([int(row[0]) for row in rows[count:]], dtype=np.intp)
    return vertices, fans_of(vertices, np.array([*map(int, corners)], dtype=np.intp), lengths, path)


def _gltf(content: bytes, path: Path) -> Mesh:
    """Read by trimesh, which skips in silence what it does not know, such as morph targets and skins, and copies a mesh
    for each node that shows it. So its JSON is checked before."""
    with parsing(path, "cannot be read as a mesh ({})", _PLAIN):
        if content[:4] == b"glTF":  # of a GLB the first chunk
            size = int.from_bytes(content[12:16], "little")
            if content[16:20] != b"JSON" or size > len(content) - 20:
                raise ValueError
        tree = json.loads(content[20 : 20 + size] if content[:4] == b"glTF" else content)
        counts = [accessor["count"] for accessor in tree["accessors"]]
        if any(type(count) is not int or count < 0 for count in counts):
            raise ValueError
        require_count(max(counts, default=0), path, "values in an accessor")
        if (why := next(_missed(tree), None)) is not None:
            raise InputError(f"{path}: {why}; expected {_PLAIN}")
        _require_bounded(tree, counts, path)
    import trimesh

    how: dict[str, Any] = {"force": "mesh", "process": False, "skip_materials": True}  # whose pictures may be any files
    how |= {"resolver": trimesh.resolvers.FilePathResolver(str(path))}
    with parsing(path, "cannot be read as a mesh ({})", f"a sound {path.suffix[1:].upper()}"):
        mesh = trimesh.load(io.BytesIO(content), path.suffix.lower()[1:], **how)
        vertices, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.intp)
    if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(vertices):
        refuse(path, f"a face names vertex {triangles.max()} of {len(vertices)}")
    return vertices, triangles


def _missed(tree: dict[str, Any]) -> Iterator[str]:
    """Yield what would change the shape and is not read, in words."""
    if required := tree.get("extensionsRequired"):
        yield f"requires {str(required[0])[:60]!r}, which is not read"
    nodes, accessors = tree.get("nodes", []), tree["accessors"]
    if tree.get("skins") or any("skin" in node for node in nodes):
        yield "has a skin, which is not read"
    if any(any(part.get("weights", [])) for part in (*nodes, *tree["meshes"])):
        yield "has morph targets with weights, which are not read"
    if any(_INSTANCES in node.get("extensions", {}) for node in nodes):
        yield f"has {_INSTANCES}, which is not read"
    for primitive in (primitive for mesh in tree["meshes"] for primitive in mesh["primitives"]):
        if _COMPRESSED in primitive.get("extensions", {}):
            yield f"has {_COMPRESSED}, which is not read"
        if primitive.get("mode", _TRIANGLES) not in _MODES:
            yield f"has primitives of mode {str(primitive['mode'])[:20]}, such as triangle fans, which are not read"
        place = accessors[primitive["attributes"]["POSITION"]]
        if place["componentType"] != _FLOAT32 or place.get("normalized"):
            yield "has points that are not float32, which are not read"
    if any("sparse" in accessor or "bufferView" not in accessor for accessor in accessors):
        yield "has an accessor that is sparse or has no values, which is not read"
    parents = Counter(child for node in nodes for child in node.get("children", []))
    for scene in tree.get("scenes", []):  # nodes must be trees, else the number of places of a mesh has no bound
        if any(count > 1 for count in (parents + Counter(scene.get("nodes", []))).values()):
            yield "has a node in more than one place"


def _require_bounded(tree: dict[str, Any], counts: list[int], path: Path) -> None:
    """Raise InputError for what becomes larger in memory, or with the files beside it, than a mesh may be."""
    shown = Counter(node["mesh"] for node in tree.get("nodes", []) if "mesh" in node)
    points = triangles = 0
    for i, mesh in enumerate(tree["meshes"]):
        for primitive in mesh["primitives"]:
            several = max(shown[i], 1)
            position = primitive["attributes"]["POSITION"]
            corners = counts[primitive.get("indices", position)]
            points += several * counts[position]
            triangles += several * (corners // 3 if primitive.get("mode", _TRIANGLES) == _TRIANGLES else corners)
    require_count(points, path, "points in all its nodes")
    require_count(triangles, path, "triangles in all its nodes")
    folder = path.parent.resolve()
    uris = (buffer["uri"] for buffer in tree.get("buffers", []) if "uri" in buffer)
    beside = [(folder / uri.strip()).resolve() for uri in uris if "base64," not in uri]
    odd = next((file for file in beside if not file.is_relative_to(folder) or not file.is_file()), None)
    if odd is not None:
        raise InputError(f"{path}: its buffer {str(odd)[:200]!r} is no plain file in its folder; expected {_PLAIN}")
    size = sum(file.stat().st_size for file in beside)
    if size > LARGEST:
        raise InputError(f"{path}: its buffers have {size / 1e6:.0f} MB; expected at most {LARGEST / 1e6:.0f} MB")
