"""Clouds from files: a PLY, an npz of points, a trial's frame, or a mesh that is sampled."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.measured_points import require_cloud
from fabdesign.npz_file import open_npz
from fabdesign.ply import read_ply
from fabdesign.surface import Surface
from fabdesign.trial_file import read_trial

POINTS = 3362  # drawn on a mesh by default: as many as the simulator's faces have
MESHES = (".obj", ".stl", ".off", ".glb", ".gltf", ".3mf")


def read_cloud(
    path: Path | str, *, frame: int = -1, points: int = POINTS, seed: int = 0, size: float | None = None
) -> NDArray[np.float64]:
    """(n, 3) m, finite and not empty.

    A PLY without faces and an npz with `points` (n, 3) are taken as they are, of a trial's npz the given `frame`;
    a mesh (a PLY with faces; .obj, .stl and others through trimesh) gives `points` even draws with `seed`.
    size: the cloth's longer side [m], for the hint that a cloud is in millimetres. Raises InputError.
    """
    path = Path(path)
    if path.suffix.lower() == ".npz":
        cloud = _npz(path, frame, size)
    else:
        mesh = read_mesh(path, size=size)
        cloud = mesh.sample(points, np.random.default_rng(seed))[0] if len(mesh.triangles) else mesh.vertices
    require_cloud(cloud, str(path), size=size)
    return cloud


def read_mesh(path: Path | str, *, size: float | None = None) -> Surface:
    """The triangles of a mesh file, in m; a PLY cloud gives none. Raises InputError."""
    path = Path(path)
    if path.suffix.lower() == ".ply":
        ply = read_ply(path)
        mesh = Surface(ply.points, ply.triangles)
    elif path.suffix.lower() in MESHES:
        mesh = _foreign_mesh(path)
    else:
        raise InputError(f"{path}: expected a cloud (.ply, .npz) or a mesh ({', '.join(MESHES)})")
    require_cloud(mesh.vertices, str(path), size=size)
    return mesh


def _npz(path: Path, frame: int, size: float | None) -> NDArray[np.float64]:
    with open_npz(path, "points (n, 3)") as arrays:
        points = None if "offsets" in arrays else arrays.get("points")
    if points is None:
        frames = read_trial(path, size=size).frames
        if not -len(frames) <= frame < len(frames):
            raise InputError(f"{path}: frame {frame}; expected -{len(frames)} to {len(frames) - 1}")
        return frames[frame]
    if points.dtype.kind not in "fiu":
        raise InputError(f"{path}: points is {points.shape} {points.dtype}; expected numbers (n, 3)")
    return points.astype(np.float64)


def _foreign_mesh(path: Path) -> Surface:
    try:
        import trimesh
    except ImportError:
        raise InputError(f"{path}: meshes need the package trimesh; pip install fabdesign[mesh]") from None
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        mesh = trimesh.load(path, force="mesh", process=False)
        vertices, triangles = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.intp)
    except Exception as error:  # trimesh raises whatever its parsers meet
        raise InputError(f"{path}: cannot be read as a mesh ({type(error).__name__})") from None
    if not len(triangles):
        raise InputError(f"{path}: has no triangles; expected a mesh")
    return Surface(vertices, triangles)
