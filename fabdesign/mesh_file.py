"""Meshes out: PLY and OBJ, a file a frame."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.ply import ply_bytes

SUFFIXES = (".ply", ".obj")


def mesh_paths(path: Path, frames: int) -> list[Path]:
    """The files of `frames` frames: `path` itself for one frame, else NAME_0000.ply, NAME_0001.ply, ... beside it.

    Raises InputError where the name ends neither in .ply nor in .obj.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: expected a mesh to write, {' or '.join(SUFFIXES)}")
    return [path] if frames == 1 else [path.with_stem(f"{path.stem}_{k:04d}") for k in range(frames)]


def write_mesh(path: Path, points: NDArray[np.floating[Any]], triangles: NDArray[np.integer[Any]]) -> None:
    """Write points (n, 3) m and triangles (t, 3), as PLY (binary, float32) or OBJ (text, to the micrometre)."""
    if path.suffix.lower() == ".ply":
        path.write_bytes(ply_bytes(points, triangles))
        return
    lines = ["# metres", *("v {:.6f} {:.6f} {:.6f}".format(*point) for point in points)]
    lines += ["f {} {} {}".format(*corners) for corners in triangles + 1]
    path.write_text("\n".join([*lines, ""]), encoding="ascii", newline="\n")
