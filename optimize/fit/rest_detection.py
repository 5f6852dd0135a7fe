"""Where a cloth stands, seen in its clouds alone: small places of a frame that are where they were a moment before."""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial import KDTree

from fabdesign.files.trial_file import TrialData
from fabdesign.nouns.array import Array, Floats, Indices
from fabdesign.nouns.trial import Trial
from optimize.fit.at_rest import Standing
from optimize.fit.clouds import Sample

HELD = 0.3  # s that it must stand at the end of constant pressures: a swing stops for a moment where it turns
AHEAD = 0.13  # s between the frames that are compared
PLACES, POINTS = 60, 60  # of a frame, and points of each
SWING = 8.0  # rad/s, of a hung cloth: a speed over this is how far it swings
CLOUD = 400  # points of a shape


def standing_of(trial: Trial, data: TrialData, noise: float, rng: np.random.Generator) -> Iterator[Standing]:
    """Yield a shape of a trial for each stretch under constant pressures at whose end the cloth stands: the rest of its
    swing is within the `noise` [m] of a point."""
    pressure = data.program.at(data.time)
    changed = np.concatenate([[True], (pressure[1:] != pressure[:-1]).any(axis=1)])
    for stretch in np.split(np.arange(len(data.time)), np.flatnonzero(changed)[1:]):
        frames = stretch[data.time[stretch] > data.time[stretch[-1]] - HELD - 1e-6]
        span = float(data.time[frames[-1]] - data.time[frames[0]])
        if span >= 0.9 * HELD and _speed([data.frames[k] for k in frames], span) <= SWING * noise:
            yield _shape(trial, data, frames, rng)


def _speed(frames: Sequence[Floats], span: float) -> float:
    """Return the speed, m/s: RMS over frames within `span` s, and over places of the cloth, along their normals. It
    includes the noise's part."""
    ahead = min(max(1, round(AHEAD * (len(frames) - 1) / span)), len(frames) - 1)
    trees = [KDTree(np.asarray(cloud, dtype=float)) for cloud in frames]
    moved = [_moved(one, other) for one, other in zip(trees, trees[ahead:], strict=False)]
    return float(np.sqrt(np.mean(np.square(moved)))) * (len(frames) - 1) / (ahead * span)


def _moved(one: KDTree, other: KDTree) -> float:
    """Return how far another cloud's mean lies off along the normal, m, RMS over places of a cloud."""
    points = min(POINTS, one.n, other.n)
    seeds = one.data[np.linspace(0, one.n - 1, min(PLACES, one.n)).astype(int)]
    patch = one.data[one.query(seeds, k=points)[1].reshape(len(seeds), -1)]
    middle = patch.mean(axis=1)
    normal = np.linalg.svd(patch - middle[:, None], full_matrices=False)[2][:, -1]
    there = other.data[other.query(middle, k=points)[1].reshape(len(seeds), -1)].mean(axis=1)
    return float(np.sqrt(np.mean(np.square(np.einsum("nd,nd->n", there - middle, normal)))))


def _shape(trial: Trial, data: TrialData, frames: Indices, rng: np.random.Generator) -> Standing:
    """Return the shape of the frames (k,) in which a cloth stands."""
    cloud = np.concatenate([np.asarray(data.frames[k], dtype=float) for k in frames])
    chosen = cloud[rng.choice(len(cloud), min(CLOUD, len(cloud)), replace=False)]
    at: Array = data.time[frames[-1:]]
    return Standing(Sample(trial, at, (chosen,)), data.program.at(at)[0])
