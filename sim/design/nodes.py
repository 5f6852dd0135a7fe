"""The grid of a design: where its nodes rest, their masses, and which are held."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from sim.design.support import Support

Array = NDArray[np.float64]


def node_arrays(design: Design, factors: Mapping[str, float], n: int) -> tuple[Array, Array, Array]:
    """Rest positions (n n, 3) m, lumped masses (n n,) kg and free (n n,), rows of rising v."""
    fabric = design.fabric
    u, v = np.linspace(0, fabric.width, n), np.linspace(0, fabric.height, n)
    uu, vv = np.meshgrid(u, v)
    rest = np.stack([uu - fabric.width / 2, -vv, np.zeros_like(uu)], axis=-1).reshape(-1, 3)
    trapezoid = np.ones(n)
    trapezoid[[0, -1]] = 0.5
    cell = u[1] * v[1]
    mass = factors.get("areal_density", 1.0) * fabric.areal_density * cell * np.outer(trapezoid, trapezoid)
    for muscle in design.muscles:
        _add_line_mass(mass, muscle.path, design.muscle_types[muscle.type].mass_per_length, u[1], v[1])
    free = np.ones((n, n))
    support = Support.of(fabric)
    if support.is_edge:
        free[support.nodes] = 0
    elif not isinstance(fabric.hung, str):
        for pu, pv in fabric.hung:
            free[round(pv / v[1]), round(pu / u[1])] = 0
    return rest, mass.ravel(), free.ravel()


def _add_line_mass(mass: Array, path: tuple[tuple[float, float], ...], density: float, hu: float, hv: float) -> None:
    corners = np.array(path)
    for a, b in pairwise(corners):
        length = float(np.linalg.norm(b - a))
        samples = max(2, int(np.ceil(4 * length / min(hu, hv))))
        share = (np.arange(samples) + 0.5) / samples
        x, y = ((a + (b - a) * share[:, None]) / (hu, hv)).T
        i, j = (np.minimum(t.astype(int), n - 2) for t, n in ((x, mass.shape[1]), (y, mass.shape[0])))
        for row, down in ((j, j + 1 - y), (j + 1, y - j)):
            for column, across in ((i, i + 1 - x), (i + 1, x - i)):
                np.add.at(mass, (row, column), down * across * (density * length / samples))
