"""Measured points against a model's surface: distances, and how they change with the model's vertices."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.files.trial_file import TrialData
from fabdesign.geometry.surface import CAP, Surface
from fabdesign.nouns.forward import SIDE
from fabdesign.nouns.trial import Trial

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Motion = NDArray[np.floating[Any]]
FAR = 2.0  # times the usual median residual: an outlying frame, which counts less


@dataclass(frozen=True, eq=False)
class Sample:
    """Some points of some frames of one trial."""

    trial: Trial
    times: Array  # (F,) s after rest
    clouds: tuple[Array, ...]  # F of (n, 3) m


def evenly(count: int, most: int) -> Indices:
    """Up to `most` of `count` indices, spread over all of them, both ends included."""
    return np.unique(np.linspace(count - 1, 0, min(most, count)).round().astype(np.intp))


def sample_trial(
    trial: Trial,
    data: TrialData,
    used: NDArray[np.bool_],
    *,
    until: float,
    frames: int,
    points: int,
    rng: np.random.Generator,
) -> Sample | None:
    """Up to `frames` frames spread over those `used` (T,) of the trial's first `until` seconds, and up to `points`
    random points of each. None where no frame is used."""
    usable = np.flatnonzero(used[: _frames_until(data.time, until)])
    if not len(usable):
        return None
    chosen = usable[evenly(len(usable), frames)]
    clouds = (data.frames[int(k)] for k in chosen)
    drawn = tuple(c if len(c) <= points else c[rng.choice(len(c), points, replace=False)] for c in clouds)
    return Sample(trial, data.time[chosen], drawn)


def _frames_until(times: Array, until: float) -> int:
    return max(int(np.searchsorted(times, until + 1e-6)), 1)


def cut(sample: Sample, until: float) -> Sample:
    """Its frames up to `until` s, at least the first."""
    count = _frames_until(sample.times, until)
    return replace(sample, times=sample.times[:count], clouds=sample.clouds[:count])


@dataclass(frozen=True)
class Loss:
    """Limits on what one residual, or one frame, can do; by default those of clouds."""

    huber: float = 1.345  # of the scale: 95 % efficient on normal noise (Huber 1981)
    far: float = FAR
    stray: float = 5.0  # times the frame's robust deviation: a point farther off is no part of an error
    largest: float = 0.020  # m: a residual farther off counts as this far where trials are left out
    cap: float = CAP  # m, the same in the RMS that a fit reports
    smallest: float = 1e-6  # m, of the scale, for clouds without noise

    def scale(self, residual: Array) -> float:
        """Robust standard deviation."""
        return max(1.4826 * float(np.median(np.abs(residual))), self.smallest)

    def of(self, t: Array) -> Array:
        """(N,) -log likelihood of residuals in units of their scale (Huber's function)."""
        size = np.abs(t)
        return np.where(size <= self.huber, 0.5 * t * t, self.huber * (size - 0.5 * self.huber))


CLOUDS = Loss()
ROWS = Loss(far=np.inf, stray=np.inf, largest=np.inf, cap=np.inf, smallest=1e-12)  # of a bench, in its output's unit


@dataclass(frozen=True, eq=False)
class Match:
    """Each measured point (N of them, all samples in a row) with the nearest place on the model's surface.

    A point beyond a hem counts by its height over the sheet alone. Its distance from the hem would widen the sheet:
    noise puts as many points inside, and those say nothing.
    """

    residual: Array  # (N,) m, height along the normal, positive off the sheet; NaN in frames that the model has lost
    normal: Array  # (N, 3) of the matched triangle, outwards
    vertex: Indices  # (N, 3) of its triangle
    weights: Array  # (N, 3) barycentric
    sample: Indices  # (N,)
    frame: Indices  # (N,) within its sample
    _: KW_ONLY
    loss: Loss = CLOUDS
    block: Indices | None = None  # (N,) which points share the model's error; None: those of half a second of a trial

    @staticmethod
    def of_rows(residual: Array, record: Indices, block: Indices) -> "Match":
        """Of a bench's rows: (N,) in the output's unit, which have no place on a surface. record, block: (N,)."""
        none = np.zeros((len(residual), 3))
        corners, frame = none.astype(np.intp), np.zeros(len(residual), dtype=np.intp)
        return Match(residual, none, corners, none, record, frame, loss=ROWS, block=block)


def match(samples: Sequence[Sample], motions: Sequence[Motion]) -> Match:
    """motions: (F, 2 n, 3) m a sample, as `ForwardModel.motions` gives them at the sample's times."""
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        parts = threads.map(_match_one, range(len(samples)), samples, motions)
        return Match(*(np.concatenate(column) for column in zip(*(p for some in parts for p in some), strict=True)))


def _match_one(s: int, sample: Sample, motion: Motion) -> list[tuple[Array | Indices, ...]]:
    """The fields of `Match`, of each frame of sample number `s`."""
    parts: list[tuple[Array | Indices, ...]] = []
    for f, (cloud, vertices) in enumerate(zip(sample.clouds, motion, strict=True)):
        where = (np.full(len(cloud), s), np.full(len(cloud), f))
        if not np.isfinite(vertices).all():
            zeros = np.zeros((len(cloud), 3))
            parts.append((np.full(len(cloud), np.nan), zeros, zeros.astype(np.intp), zeros, *where))
            continue
        surface = Surface.of_faces(vertices)
        near = surface.nearest(cloud)
        corners = surface.triangles[near.triangle]
        offset = cloud - np.einsum("nc,ncd->nd", near.weights, surface.vertices[corners])
        normal = surface.normals_of(near.triangle)
        parts.append((np.einsum("nd,nd->n", offset, normal), normal, corners, near.weights, *where))
    return parts


def frames_of(match: Match, rows: NDArray[np.bool_] | slice = slice(None)) -> tuple[Indices, list[Indices]]:
    """Of the points `rows`, counted among themselves: the frame of each, and the points of each frame."""
    _, frame = np.unique(match.sample[rows] * 100_000 + match.frame[rows], return_inverse=True)
    return frame, np.split(np.argsort(frame, kind="stable"), np.cumsum(np.bincount(frame))[:-1])


@dataclass(frozen=True, eq=False)
class Nodes:
    """Where the matched places lie on a grid of n x n nodes: a residual changes by `-normal @ (weights @ moved nodes)`.

    The normal's own turn moves the face along the face: to first order the height over it does not see that. So nodes
    of the mid-surface say all, and no face is made of a motion that only a derivative asks for.
    """

    node: Indices  # (N, 4)
    weighted: Array  # (N, 4, 3): minus the normal, by bilinear weight


def nodes_of(match: Match, side: int, face: int = SIDE) -> Nodes:
    """side: nodes a side of the grid that the derivatives are made on; face: points a side of the faces matched."""
    place = match.vertex % (face * face)
    across, down = (
        np.einsum("nc,nc->n", match.weights, k.astype(np.float64)) * (side - 1) / (face - 1)
        for k in (place % face, place // face)
    )
    column, row = (np.clip(at.astype(np.intp), 0, side - 2) for at in (across, down))
    a, b = across - column, down - row
    first = row * side + column
    node = np.stack([first, first + 1, first + side, first + side + 1], axis=1)
    weights = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], axis=1)
    return Nodes(node, -weights[:, :, None] * match.normal[:, None, :])


def derivatives(match: Match, nodes: Nodes, changes: Sequence[Motion]) -> Array:
    """(N, k) m: change of each residual. changes: (k, F, n, n, 3) m a sample, of the mid-surface.

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
