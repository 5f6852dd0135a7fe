"""Regions that intervals are said of: the mean height of the cloth over the predicted one in each of nine regions,
along the normal of the predicted mid-surface."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from corrector.examples import offsets
from corrector.shape import FINE, LocalFrames, middle_of
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import SIDE

Array = NDArray[np.float64]
Motion = NDArray[np.floating]
REGIONS = 3  # a side


def region_terms(rest: Motion, predicted: Motion, drawn: Sequence[Motion], fabric: Fabric) -> tuple[Array, Array]:
    """Return (T, REGIONS, REGIONS) m each: the standard deviation over the drawn models' motions, 0 without two of
    them, and how far a region has moved since rest. rest: (2 n^2, 3) m; predicted and drawn: (T, 2 n^2, 3) m."""
    middle = middle_of(predicted, SIDE)
    nodes = _nodes(middle)
    per_region = by_region(np.ones((1, *nodes.shape[1:3])))[0]
    moved = by_region(np.linalg.norm(nodes - _nodes(middle_of(rest, SIDE)[None]), axis=-1)) / per_region
    sound = [other for other in drawn if np.isfinite(other).all()]
    if len(sound) < 2:
        return np.zeros_like(moved), np.asarray(moved)
    normal = normals(predicted, fabric)
    along = [np.einsum("tabi,tabi->tab", _nodes(middle_of(other, SIDE)) - nodes, normal) for other in sound]
    return np.array([by_region(one) for one in np.array(along)]).std(axis=0, ddof=1) / per_region, np.asarray(moved)


def region_residuals(predicted: Motion, clouds: Sequence[Array], fabric: Fabric) -> Array:
    """Return (T, REGIONS, REGIONS) m from the predicted cloth to the measured one; NaN where no point was measured."""
    middle = middle_of(predicted, SIDE)
    pairs = [offsets(one, cloud, fabric.thickness) for one, cloud in zip(middle, clouds, strict=True)]
    heights, counts = (np.array([pair[k] for pair in pairs], dtype=float) for k in (0, 1))
    weight = by_region(counts)
    mean = by_region(heights * counts) / np.maximum(weight, 1e-9)
    return np.asarray(np.where(weight > 0, mean, np.nan))


def normals(predicted: Motion, fabric: Fabric) -> Motion:
    """Return (T, FINE, FINE, 3) of unit length, off the front."""
    return LocalFrames.of(middle_of(predicted, SIDE), fabric.width, fabric.height, FINE).normal


def _nodes(middle: Motion) -> Motion:
    """Return (T, FINE, FINE, 3) m."""
    every = (SIDE - 1) // (FINE - 1)
    return middle[:, ::every, ::every]


def by_region(values: Motion) -> Array:
    """Return (T, REGIONS, REGIONS) sums of (T, n, n)."""
    edges = np.linspace(0, values.shape[1], REGIONS + 1).astype(int)[:-1]
    return np.asarray(np.add.reduceat(np.add.reduceat(values, edges, axis=1), edges, axis=2))
