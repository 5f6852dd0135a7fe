"""A mesh written as each kind of file, byte by byte and apart from the readers."""

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def sheet(across: int = 8, down: int = 8, *, size: float = 0.2, roll: float = 0.0) -> tuple[NDArray, NDArray]:
    """((n, 3) m, (t, 3)): one layer of cloth hung at y = 0, straight for its upper half and then rolled towards the
    viewer with curvature `roll` [1/m]."""
    u, v = np.meshgrid(np.linspace(0, size, across + 1), np.linspace(0, size, down + 1))
    bent = np.maximum(v - size / 2, 0)
    arc = (bent, 0 * bent) if roll == 0 else (np.sin(roll * bent) / roll, (1 - np.cos(roll * bent)) / roll)
    points = np.stack([u - size / 2, -(np.minimum(v, size / 2) + arc[0]), arc[1]], axis=-1).reshape(-1, 3)
    corner = np.arange((across + 1) * (down + 1)).reshape(down + 1, across + 1)
    a, b, c, d = (x.ravel() for x in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
    return points, np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])


def write_stl(path: Path, points: NDArray, triangles: NDArray, *, ascii: bool = False) -> Path:
    corners = points[triangles]
    if ascii:
        rows = ["solid a sheet"]
        for facet in corners:
            rows += ["facet normal 0 0 1", "outer loop", *("vertex {:.9g} {:.9g} {:.9g}".format(*p) for p in facet)]
            rows += ["endloop", "endfacet"]
        path.write_text("\n".join([*rows, "endsolid a sheet\n"]))
    else:
        body = b"".join(struct.pack("<12fH", 0, 0, 1, *facet.ravel(), 0) for facet in corners)
        path.write_bytes(b"binary".ljust(80) + struct.pack("<I", len(corners)) + body)
    return path


def write_obj(path: Path, points: NDArray, triangles: NDArray) -> Path:
    rows = ["# a sheet", "o sheet", *("v {!r} {!r} {!r}".format(*map(float, p)) for p in points), "vt 0 0", "s off"]
    path.write_text("\n".join([*rows, *("f {}/1 {}/1 {}/1".format(*(t + 1)) for t in triangles), ""]))
    return path


def write_xyz(path: Path, points: NDArray, *, mark: str = " ", header: str = "") -> Path:
    rows = [mark.join(repr(float(x)) for x in p) for p in points]
    path.write_text("\n".join([*([header] if header else []), *rows, ""]))
    return path
