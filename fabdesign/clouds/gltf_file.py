"""Checks of what a glTF or GLB may hold: trimesh skips in silence what it does not know, such as morph targets and
skins, and copies a mesh for each node that shows it. So its JSON is checked before."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

from fabdesign.errors import InputError
from fabdesign.formats.bounded_file import LARGEST, require_few

_FLOAT32, _TRIANGLES = 5126, 4
_MODES = range(6)  # points, lines, triangles and their strips; trimesh leaves out fans in silence
_COMPRESSED = "KHR_draco_mesh_compression"
_INSTANCES = "EXT_mesh_gpu_instancing"
_EXPECTED = "expected a sound glTF of plain triangles"


def require_plain(content: bytes, path: Path) -> None:
    """Raise InputError for a file whose shape is not just its nodes' meshes of float32 points, or that becomes larger
    in memory, or with the files beside it, than a mesh may be."""
    try:
        tree = json.loads(_json_of(content))
        counts = _counts(tree, path)
        why = next((words for words in (_not_handled(tree), _unsound_nodes(tree)) if words), None)
        if why is None:
            _require_bounded(tree, counts, path)
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError, OSError) as error:
        why = f"cannot be read as a mesh ({type(error).__name__})"
    if why is not None:
        raise InputError(f"{path}: {why}; {_EXPECTED}")


def _json_of(content: bytes) -> bytes:
    """Return the text of a glTF, or of a GLB's first chunk."""
    if content[:4] != b"glTF":
        return content
    size = int.from_bytes(content[12:16], "little")
    if content[16:20] != b"JSON" or size > len(content) - 20:
        raise ValueError
    return content[20 : 20 + size]


def _not_handled(tree: dict[str, Any]) -> str | None:
    """Return what would change the shape and is not read, in words."""
    if required := tree.get("extensionsRequired"):
        return f"requires {str(required[0])[:60]!r}, which is not read"
    nodes, accessors = tree.get("nodes", []), tree["accessors"]
    if tree.get("skins") or any("skin" in node for node in nodes):
        return "has a skin, which is not read"
    if any(any(part.get("weights", [])) for part in (*nodes, *tree["meshes"])):
        return "has morph targets with weights, which are not read"
    if any(_INSTANCES in node.get("extensions", {}) for node in nodes):
        return f"has {_INSTANCES}, which is not read"
    for primitive in (primitive for mesh in tree["meshes"] for primitive in mesh["primitives"]):
        if _COMPRESSED in primitive.get("extensions", {}):
            return f"has {_COMPRESSED}, which is not read"
        if primitive.get("mode", _TRIANGLES) not in _MODES:
            return f"has primitives of mode {str(primitive['mode'])[:20]}, such as triangle fans, which are not read"
        place = accessors[primitive["attributes"]["POSITION"]]
        if place["componentType"] != _FLOAT32 or place.get("normalized"):
            return "has points that are not float32, which are not read"
    if any("sparse" in accessor or "bufferView" not in accessor for accessor in accessors):
        return "has an accessor that is sparse or has no values, which is not read"
    return None


def _unsound_nodes(tree: dict[str, Any]) -> str | None:
    """Nodes must be trees, else the number of places of a mesh has no bound."""
    parents = Counter(child for node in tree.get("nodes", []) for child in node.get("children", []))
    for scene in tree.get("scenes", []):
        if any(count > 1 for count in (parents + Counter(scene.get("nodes", []))).values()):
            return "has a node in more than one place"
    return None


def _counts(tree: dict[str, Any], path: Path) -> list[int]:
    counts = [accessor["count"] for accessor in tree["accessors"]]
    if any(type(count) is not int or count < 0 for count in counts):
        raise ValueError
    require_few(max(counts, default=0), path, "values in an accessor")
    return counts


def _require_bounded(tree: dict[str, Any], counts: list[int], path: Path) -> None:
    shown = Counter(node["mesh"] for node in tree.get("nodes", []) if "mesh" in node)
    points = triangles = 0
    for i, mesh in enumerate(tree["meshes"]):
        for primitive in mesh["primitives"]:
            several = max(shown[i], 1)
            position = primitive["attributes"]["POSITION"]
            corners = counts[primitive.get("indices", position)]
            points += several * counts[position]
            triangles += several * (corners // 3 if primitive.get("mode", _TRIANGLES) == _TRIANGLES else corners)
    require_few(points, path, "points in all its nodes")
    require_few(triangles, path, "triangles in all its nodes")
    uris = [buffer["uri"] for buffer in tree.get("buffers", []) if "uri" in buffer]
    folder = path.parent.resolve()
    beside = [(folder / uri.strip()).resolve() for uri in uris if "base64," not in uri]
    odd = next((file for file in beside if not file.is_relative_to(folder) or not file.is_file()), None)
    if odd is not None:
        raise InputError(f"{path}: its buffer {str(odd)[:200]!r} is no plain file in its folder; {_EXPECTED}")
    size = sum(file.stat().st_size for file in beside)
    if size > LARGEST:
        raise InputError(f"{path}: its buffers have {size / 1e6:.0f} MB; expected at most {LARGEST / 1e6:.0f} MB")
