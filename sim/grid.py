"""The grid of a design: how the cloth is held, where its nodes rest, their masses."""

from collections.abc import Iterator, Sequence
from enum import IntEnum
from itertools import pairwise

import numpy as np

from fabdesign.effects.declaration import Specimen
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.muscle import Muscle


class Support(IntEnum):
    """The kinds of support. Kernels take the number; edges come first."""

    TOP = 0
    BOTTOM = 1
    LEFT = 2
    RIGHT = 3
    NONE = 4
    POINTS = 5

    @classmethod
    def of(cls, fabric: Fabric) -> "Support":
        return cls[fabric.hung.upper()] if isinstance(fabric.hung, str) else cls.POINTS

    @property
    def is_edge(self) -> bool:
        """Return whether the preconditioner knows what is held: it does not know single nodes."""
        return self < EDGES

    @property
    def nodes(self) -> tuple[int | slice, int | slice]:
        """Return the rows and columns of a held edge on the grid."""
        every = slice(None)
        return ((0, every), (-1, every), (every, 0), (every, -1))[self]


EDGES = 4  # kinds of support below this are edges
TOP, BOTTOM, LEFT, RIGHT = range(EDGES)  # for kernels


Path = tuple[tuple[float, float], ...]
FINE = 0.0025  # m between the points over which a node's mean is taken


def node_arrays(fabric: Fabric, n: int) -> tuple[Array, Array]:
    """Return the rest positions (n n, 3) m and free (n n,), rows of rising v."""
    u, v = np.linspace(0, fabric.width, n), np.linspace(0, fabric.height, n)
    uu, vv = np.meshgrid(u, v)
    rest = np.stack([uu - fabric.width / 2, -vv, np.zeros_like(uu)], axis=-1).reshape(-1, 3)
    free = np.ones((n, n))
    support = Support.of(fabric)
    if support.is_edge:
        free[support.nodes] = 0
    elif not isinstance(fabric.hung, str):
        for pu, pv in fabric.hung:
            free[round(pv / v[1]), round(pu / u[1])] = 0
    return rest, free.ravel()


def masses(specimen: Specimen, n: int) -> Array:
    """Return (n n,) kg, lumped: cloth, muscles along their paths, added ones."""
    design, fabric = specimen.design, specimen.design.fabric
    u, v = np.linspace(0, fabric.width, n), np.linspace(0, fabric.height, n)
    trapezoid = np.ones(n)
    trapezoid[[0, -1]] = 0.5
    cell = u[1] * v[1]
    mass = specimen.factors.get("areal_density", 1.0) * fabric.areal_density * cell * np.outer(trapezoid, trapezoid)
    for muscle in design.muscles:
        density = design.muscle_types[muscle.type].mass_per_length
        for x, y, each in _line_masses(muscle.path, density, u[1], v[1]):
            _add_masses(mass, x, y, each)
    for at_u, at_v, added in specimen.masses:
        _add_masses(mass, np.array([at_u / u[1]]), np.array([at_v / v[1]]), added)
    return np.asarray(mass.ravel())


def node_means(specimen: Specimen, name: str, n: int) -> Array:
    """Return (n n,) means over the nodes' areas of what differs by place; 0 where nothing does."""
    value, fabric = specimen.places.get(name), specimen.design.fabric
    if value is None:
        return np.zeros(n * n)
    u, v = (_points_within(size, n) for size in (fabric.width, fabric.height))
    values = value(*np.meshgrid(u.ravel(), v.ravel()))
    return np.asarray(values.reshape(n, v.shape[1], n, u.shape[1]).mean(axis=(1, 3)).ravel())


def _points_within(size: float, n: int) -> Array:
    """Return (n, k) m, points even over the stretches of n nodes."""
    h = size / (n - 1)
    ends = np.clip((np.arange(n + 1) - 0.5) * h, 0.0, size)
    count = int(np.ceil(h / FINE))
    return np.asarray(ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(count) + 0.5) / count)


def _line_masses(path: Path, density: float, hu: float, hv: float) -> Iterator[tuple[Array, Array, float]]:
    """Yield points of a muscle along each part of its path, in spacings, and their masses [kg]."""
    corners = np.array(path)
    for a, b in pairwise(corners):
        length = float(np.linalg.norm(b - a))
        samples = max(2, int(np.ceil(4 * length / min(hu, hv))))
        share = (np.arange(samples) + 0.5) / samples
        x, y = ((a + (b - a) * share[:, None]) / (hu, hv)).T
        yield x, y, density * length / samples


def muscle_masses(muscles: Sequence[tuple[Muscle, float]], spacing: tuple[float, float], n: int) -> Array:
    """Return (n n,) kg that muscles of so much mass a length [kg/m] each lay on the nodes."""
    mass = np.zeros((n, n))
    parts = [
        (x, y, np.full(len(x), each))
        for muscle, density in muscles
        for x, y, each in _line_masses(muscle.path, density, *spacing)
    ]
    _add_masses(mass, *(np.concatenate(values) for values in zip(*parts, strict=True)))
    return np.asarray(mass.ravel())


def _add_masses(mass: Array, x: Array, y: Array, each: float | Array) -> None:
    """Add masses of `each` kg at columns x and rows y to the nodes around, bilinearly."""
    i, j = (np.minimum(t.astype(int), n - 2) for t, n in ((x, mass.shape[1]), (y, mass.shape[0])))
    for row, down in ((j, j + 1 - y), (j + 1, y - j)):
        for column, across in ((i, i + 1 - x), (i + 1, x - i)):
            np.add.at(mass, (row, column), down * across * each)
