"""Around the cloth."""

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from studies.rig.effects.declaration import RigEffect
from studies.rig.scene import Scene

Array = NDArray[np.float64]


def normals(scene: Scene, x: Array, along_u: sp.csr_matrix, along_v: sp.csr_matrix) -> Array:
    """Return (q, 3) unit normals towards the front at the quadrature points."""
    n = np.cross(along_v @ x, along_u @ x)
    return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))


def air_drag(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Quadratic drag against the normal velocity: coefficient abs(v_n) v_n per area."""
    value, along_u, along_v = (scene.patch.matrix(scene.uv, *d) for d in ((0, 0), (1, 0), (0, 1)))

    def drag(time: float, x: Array, v: Array) -> Array:
        n = normals(scene, x, along_u, along_v)
        speed = np.einsum("qi,qi->q", value @ v, n)
        force = -values["coefficient"] * np.abs(speed) * speed * scene.weight
        return np.asarray(value.T @ (force[:, None] * n))

    scene.loads.append(drag)


def frame_tilt(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """The frame leans: gravity turns about the frame's x and z axes."""
    a, c = np.radians(values["about_x"]), np.radians(values["about_z"])
    turn_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    turn_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    scene.gravity = turn_z @ turn_x @ scene.gravity


def added_mass(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """A mass fixed to one point of the cloth."""
    row = scene.patch.matrix(np.array([[values["u"], values["v"]]]))
    scene.mass = (scene.mass + values["mass"] * (row.T @ row)).tocsr()


EFFECTS = {
    "air_drag": RigEffect("environment", {"coefficient": (3.0, "N s^2/m^4")}, air_drag),
    "frame_tilt": RigEffect("environment", {"about_x": (3.0, "deg"), "about_z": (0.0, "deg")}, frame_tilt),
    "added_mass": RigEffect("environment", {"u": (0.15, "m"), "v": (0.18, "m"), "mass": (0.005, "kg")}, added_mass),
}
