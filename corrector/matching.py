"""Measured points against a model's mid-surface: how far the cloth lies off it along the normal, node by node."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from corrector.shape import FINE
from fabdesign.surface import Surface, face_triangles

Floats = NDArray[np.floating[Any]]

_WIDTHS = (5, 5, 5, 3, 3, 3)  # nodes, of the squares over which a round takes its means: wide as long as faces mix
_SOFTNESS = (0.7e-3, 0.7e-3, 0.7e-3, 0.5e-3, 0.5e-3, 0.5e-3)  # m: how sharply a point is taken for one face's
_FAR = (5e-3, 5e-3, 3e-3, 3e-3, 3e-3, 3e-3)  # m: points farther off are strays


def offsets(middle: Floats, cloud: Floats, thickness: float, nodes: int = FINE) -> tuple[Floats, Floats]:
    """(nodes, nodes) m from the mid-surface (side, side, 3) to the measured cloth, along its normal, and on how many
    points of the cloud (n, 3) each is the mean; 0 where there is none.

    A point does not say on which face it is: two faces 2 mm apart and 2 mm of error look alike, point by point. Around
    a node they are two layers a thickness apart; expectation-maximisation over the two, from the mean of both, tells
    them apart, as `fabdesign.sensor_noise` does without a model. A point beyond a hem counts by its height alone.
    """
    height, row, col = _heights(np.asarray(middle, dtype=np.float64), cloud)
    every = (middle.shape[0] - 1) // (nodes - 1)
    index = np.rint(row / every).astype(np.intp) * nodes + np.rint(col / every).astype(np.intp)
    half = thickness / 2

    def mean(value: Floats, weight: Floats, width: int) -> tuple[Floats, Floats]:
        total, count = (np.bincount(index, x, nodes * nodes).reshape(nodes, nodes) for x in (value * weight, weight))
        if width > 1:
            total, count = (uniform_filter(x, width, mode="constant") for x in (total, count))
        return np.asarray(total / np.maximum(count, 1e-9)), np.asarray(count)

    weight, face = np.ones(len(height)), np.zeros(len(height))
    offset, _ = mean(height, weight, _WIDTHS[0])
    for width, softness, far in zip(_WIDTHS, _SOFTNESS, _FAR, strict=True):
        off = height - offset.ravel()[index]
        weight = (np.abs(off) < far).astype(np.float64)
        face = np.tanh(off * half / softness**2)
        offset, _ = mean(height - half * face, weight, width)
    return mean(height - half * face, weight, 1)


def _heights(middle: Floats, cloud: Floats) -> tuple[Floats, Floats, Floats]:
    """(n,) height [m] over the nearest triangle's plane, and row and column of the nearest place."""
    side = middle.shape[0]
    triangles = face_triangles(side, side)[: 2 * (side - 1) ** 2]
    surface = Surface(middle.reshape(-1, 3).astype(np.float64), triangles)
    near = surface.nearest(cloud)
    corners = triangles[near.triangle]
    place = np.einsum("nc,ncd->nd", near.weights, surface.vertices[corners])
    height = np.einsum("nd,nd->n", cloud - place, surface.normals_of(near.triangle))
    rows, cols = np.divmod(corners, side)
    return height, (near.weights * rows).sum(axis=1), (near.weights * cols).sum(axis=1)
