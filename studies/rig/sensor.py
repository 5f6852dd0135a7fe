"""The point sensor of a measurement set: random points on both faces, with noise and strays."""

import numpy as np
from numpy.typing import NDArray

from studies.rig.key import Sensing
from studies.rig.scene import Scene

Array = NDArray[np.float64]
STRAY_REACH = 0.05  # m around the cloth's box


def faces(scene: Scene, x: Array, uv: Array, side: Array) -> Array:
    """(n, 3) m: points of the faces at `uv` (n, 2) m; side (n,) is 1 in front and -1 at the back."""
    patch = scene.patch
    a1, a2 = patch.matrix(uv, 1, 0) @ x, patch.matrix(uv, 0, 1) @ x
    normal = np.cross(a2, a1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    half = scene.design.fabric.thickness / 2
    return np.asarray(patch.matrix(uv) @ x + (half * side)[:, None] * normal)


def measure(scene: Scene, x: Array, sensing: Sensing, rng: np.random.Generator) -> Array:
    """One frame: sensing.points points (n, 3) m of the cloth with control points x."""
    n = sensing.points
    fabric = scene.design.fabric
    uv = rng.random((n, 2)) * [fabric.width, fabric.height]
    points = faces(scene, x, uv, rng.choice([-1.0, 1.0], n))
    points += rng.normal(0.0, sensing.noise, points.shape)
    stray = rng.random(n) < sensing.strays
    low, high = points.min(axis=0) - STRAY_REACH, points.max(axis=0) + STRAY_REACH
    points[stray] = rng.uniform(low, high, (int(stray.sum()), 3))
    for distort in scene.sensed:
        points = distort(points)
    return points
