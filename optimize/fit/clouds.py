"""Measured points against a model's surface: distances, and how they change with the model's vertices."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.files.trial_file import TrialData
from fabdesign.geometry.shape import bilinear
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.array import Array, Indices
from fabdesign.nouns.forward import SIDE
from fabdesign.nouns.trial import Trial
from optimize.fit.misfit import Misfit

Motion = NDArray[np.floating[Any]]
BLOCK = 0.5  # s: residuals of one trial within it count as one observation, about half a swing of the cloth


@dataclass(frozen=True, eq=False)
class Sample:
    """Some points of some frames of one trial."""

    trial: Trial
    times: Array  # (F,) s after rest
    clouds: tuple[Array, ...]  # F of (n, 3) m


@dataclass(frozen=True)
class Density:
    """The sample that is drawn of each trial: frames spread over its first `until` s, and random points of each."""

    until: float  # s
    frames: int
    points: int


def evenly(count: int, most: int) -> Indices:
    """Return up to `most` of `count` indices, spread over all of them, both ends included."""
    return np.unique(np.linspace(count - 1, 0, min(most, count)).round().astype(np.intp))


def drawn(trial: Trial, data: TrialData, frames: Indices, points: int, rng: np.random.Generator) -> Sample:
    """Return the frames (F,) of a trial, with up to so many random points of each."""
    clouds = (data.frames[int(k)] for k in frames)
    some = tuple(c if len(c) <= points else c[rng.choice(len(c), points, replace=False)] for c in clouds)
    return Sample(trial, data.time[frames], some)


@dataclass(frozen=True, eq=False)
class Match(Misfit):
    """Each measured point with the nearest place on the model's surface; its residual is the height along the normal,
    positive off the sheet.

    A point beyond a hem counts by its height over the sheet alone. Its distance from the hem would widen the sheet:
    noise puts as many points inside, and those say nothing.
    """

    normal: Array  # (N, 3) of the matched triangle, outwards
    vertex: Indices  # (N, 3) of its triangle
    weights: Array  # (N, 3) barycentric


def places_on_cloth(match: Match) -> Array:
    """Return (3, N): u and v of the matched places, -1 to 1, and 1 on the front, -1 on the back."""
    place = match.vertex % (SIDE * SIDE)
    u, v = (np.einsum("nc,nc->n", match.weights, 2 * k / (SIDE - 1) - 1) for k in (place % SIDE, place // SIDE))
    return np.stack([u, v, np.where(match.vertex[:, 0] < SIDE * SIDE, 1.0, -1.0)])


def match(samples: Sequence[Sample], motions: Sequence[Motion]) -> Match:
    """Return the match of all samples. motions: (F, 2 n, 3) m a sample, as `ForwardModel.motions` gives them."""
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        parts = threads.map(_match_one, range(len(samples)), samples, motions)
        return Match(*(np.concatenate(column) for column in zip(*(p for some in parts for p in some), strict=True)))


def _match_one(s: int, sample: Sample, motion: Motion) -> list[tuple[Array | Indices, ...]]:
    """Return the fields of `Match`, of each frame of sample number `s`."""
    parts: list[tuple[Array | Indices, ...]] = []
    for f, (cloud, vertices) in enumerate(zip(sample.clouds, motion, strict=True)):
        block = s * 10_000 + int(sample.times[f] / BLOCK - 1e-6)
        where = (np.full(len(cloud), s), np.full(len(cloud), f), np.full(len(cloud), block))
        if not np.isfinite(vertices).all():
            zeros = np.zeros((len(cloud), 3))
            parts.append((np.full(len(cloud), np.nan), *where, zeros, zeros.astype(np.intp), zeros))
            continue
        surface = Surface.of_faces(vertices)
        nearest = surface.nearest(cloud)
        corners = surface.triangles[nearest.triangle]
        offset = cloud - np.einsum("nc,ncd->nd", nearest.weights, surface.vertices[corners])
        normal = surface.normals_of(nearest.triangle)
        parts.append((np.einsum("nd,nd->n", offset, normal), *where, normal, corners, nearest.weights))
    return parts


@dataclass(frozen=True, eq=False)
class Nodes:
    """Where the matched places lie on a grid of n x n nodes: a residual changes by `-normal @ (weights @ moved nodes)`.

    The normal's own turn moves the face along the face: to first order the height over it does not see that. So nodes
    of the mid-surface say all, and no face is made of a motion that only a derivative asks for.
    """

    node: Indices  # (N, 4)
    weighted: Array  # (N, 4, 3): minus the normal, by bilinear weight


def nodes_of(match: Match, side: int, face: int = SIDE) -> Nodes:
    """Return the nodes of the matched places. side: nodes a side of the derivatives' grid; face: points a side."""
    place = match.vertex % (face * face)
    at = [
        np.einsum("nc,nc->n", match.weights, k.astype(np.float64)) * (side - 1) / (face - 1)
        for k in (place % face, place // face)
    ]
    node, weights = bilinear(np.stack(at, axis=1), side, side)
    return Nodes(node, -weights[:, :, None] * match.normal[:, None, :])


def derivatives(match: Match, nodes: Nodes, changes: Sequence[Motion]) -> Array:
    """Return the change of each residual, (N, k) m. changes: (k, F, n, n, 3) m a sample, of the mid-surface.

    To first order the distance changes by the motion of the matched place along the normal: where the nearest place
    slides to does not matter, as it is the nearest. NaN where a change is not known.
    """
    result = np.empty((len(match.residual), len(changes[0])))

    def fill(s: int, change: Motion) -> None:
        rows = np.flatnonzero(match.sample == s)
        flat = change.reshape(*change.shape[:2], -1, 3)
        frame, node, weighted = match.frame[rows, None], nodes.node[rows], nodes.weighted[rows]
        for k, moved in enumerate(flat):
            result[rows, k] = np.einsum("ncd,ncd->n", weighted, moved[frame, node])

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        for _ in threads.map(fill, range(len(changes)), changes):
            pass
    return result
