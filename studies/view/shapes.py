"""The parts that a panel is drawn from: triangles in parts of one colour, the muscles as thin tubes on the cloth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fabdesign.nouns.array import Array
from studies.view.items import Item

Triangles = NDArray[np.int64]
AROUND = 6  # points of a tube's ring
FRONT, BACK, MESH, CLOUD = (0.80, 0.22, 0.22), (0.22, 0.45, 0.75), (0.45, 0.60, 0.42), (0.13, 0.17, 0.24)  # RGB
MUSCLE = 0.93, 0.69, 0.13
OVERLAY = 0.34, 0.71, 0.91  # light: it differs from all others for colour-blind people too
RGB = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class MeshPart:
    name: str
    colour: tuple[float, float, float]  # RGB, 0 to 1
    triangles: Triangles  # (t, 3), over the vertices of its item


def key_of(items: Sequence[Item], *, overlay: bool) -> list[tuple[str, RGB]]:
    """Return what the colours of panels stand for, those that occur. overlay: whether any shows its reference too."""
    cloth = any(item.is_cloth for item in items)
    key = [("front", FRONT, cloth), ("back", BACK, cloth)]
    key.append(("muscles", MUSCLE, any(item.muscles is not None for item in items)))
    key.append(("mesh", MESH, any(item.triangles is not None and not item.is_cloth for item in items)))
    key.append(("points of a cloud", CLOUD, any(item.triangles is None for item in items)))
    key.append(("overlaid points of what a panel is compared with", OVERLAY, overlay))
    return [(name, colour) for name, colour, occurs in key if occurs]


def parts_of(item: Item) -> list[MeshPart]:
    """Return the parts of a panel with triangles; none of a cloud."""
    if item.triangles is None:
        return []
    triangles = np.asarray(item.triangles, np.int64)
    half = len(triangles) // 2
    parts = (
        [MeshPart("front", FRONT, triangles[:half]), MeshPart("back", BACK, triangles[half:])]
        if item.is_cloth
        else [MeshPart("mesh", MESH, triangles)]
    )
    begin = len(item.frames[0])
    if item.muscles is not None:
        for number, span in enumerate(item.muscles.spans):
            count = span.stop - span.start
            parts.append(MeshPart(f"muscle {number}", MUSCLE, begin + _tube_triangles(count)))
            begin += AROUND * count
    return parts


def vertices_of(item: Item) -> list[NDArray[np.float32]]:
    """Return (n, 3) m of every frame: its points, then those of the muscles' tubes, in the order of `parts_of`."""
    frames = [np.asarray(frame, np.float32) for frame in item.frames]
    if item.muscles is None or item.triangles is None:
        return frames
    tubes = [
        _tube(item.muscles.points[:, span], diameter / 2)
        for span, diameter in zip(item.muscles.spans, item.muscles.diameters, strict=True)
    ]
    return [np.concatenate([frame, *(tube[k] for tube in tubes)]) for k, frame in enumerate(frames)]


def points_beneath(item: Item) -> Triangles:
    """Return for every vertex of the muscles' tubes the point of the cloth, on the muscle's side, that it lies on."""
    if item.muscles is None or not item.is_cloth:
        return np.zeros(0, np.int64)
    points, half = np.asarray(item.frames[0]), len(item.frames[0]) // 2
    beneath = []
    for span, side in zip(item.muscles.spans, item.muscles.sides, strict=True):
        begin = 0 if side == 1 else half
        nearest = cKDTree(points[begin : begin + half]).query(item.muscles.points[0, span])[1] + begin
        beneath.append(np.repeat(nearest, AROUND))
    return np.concatenate([np.zeros(0, np.int64), *beneath])


def _tube(axis: NDArray[np.float32], radius: float) -> NDArray[np.float32]:
    """Return (T, AROUND * p, 3) m around axes (T, p, 3) m. Its rings turn as little as they can from point to point and
    from frame to frame, so that a vertex stays the same place of the muscle."""
    at = np.asarray(axis, np.float64)
    along = np.gradient(at, axis=1)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    sideways = np.empty_like(along)
    for t in range(len(at)):
        for k in range(at.shape[1]) if t == 0 else ():
            before = sideways[0, k - 1] if k else np.eye(3)[np.abs(along[0, 0]).argmin()]
            sideways[0, k] = _across(before, along[0, k])
        if t:
            sideways[t] = _across(sideways[t - 1], along[t])
    turn = 2 * np.pi * np.arange(AROUND) / AROUND
    other = np.cross(along, sideways)
    ring = np.cos(turn)[:, None] * sideways[:, :, None] + np.sin(turn)[:, None] * other[:, :, None]
    return np.asarray((at[:, :, None] + radius * ring).reshape(len(at), -1, 3), np.float32)


def _across(vector: Array, along: Array) -> Array:
    """Return the part of `vector` (..., 3) square to `along` (..., 3), of unit length."""
    across = vector - (vector * along).sum(axis=-1, keepdims=True) * along
    return np.asarray(across / np.linalg.norm(across, axis=-1, keepdims=True))


def _tube_triangles(count: int) -> Triangles:
    """Return the triangles of a tube of `count` rings, its ends closed, outwards."""
    ring, next_in_ring = np.arange(AROUND), (np.arange(AROUND) + 1) % AROUND
    begins = AROUND * np.arange(count - 1)[:, None]
    a, b = begins + ring, begins + next_in_ring
    c, d = a + AROUND, b + AROUND
    mantle = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([b, d, c], axis=-1)]).reshape(-1, 3)
    fan = np.stack([np.zeros(AROUND - 2, int), ring[1:-1], ring[2:]], axis=-1)
    return np.concatenate([mantle, fan[:, ::-1], AROUND * (count - 1) + fan])


def vertex_normals(vertices: NDArray[np.float32], triangles: Triangles) -> NDArray[np.float32]:
    """Return (n, 3) of unit length, means of the triangles' around by area; up where a vertex has none."""
    a, b, c = (np.asarray(vertices, np.float64)[triangles[:, k]] for k in range(3))
    each = np.cross(b - a, c - a)
    corners = triangles.T.ravel()
    summed = [np.bincount(corners, np.tile(each[:, k], 3), len(vertices)) for k in range(3)]
    normals = np.stack(summed, axis=-1)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(length > 0, normals / np.where(length > 0, length, 1), [0, 1, 0]).astype(np.float32)
