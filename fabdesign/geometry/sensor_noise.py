"""The sensor's noise as the measured clouds themselves show it."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fabdesign.errors import InputError
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.array import Array, Floats

_NEIGHBOURS = 64  # in a patch: enough that its six coefficients and the faces do not absorb the noise
_PATCHES = 9_000  # that sigma is estimated from, at most, spread over the frames
_ROUNDS = 40  # at most
_SUSPECT_ROUNDS = 5  # with sigma known
_CONVERGED = 1e-3  # of sigma, in a round
_ALONE = 0.5  # second neighbour over farthest of a patch: of a flat sheet three points in 10^7 have more
_HIDDEN = 5  # sigmas off its face, below which a stray is taken for noise
_TERMS = 6  # of a quadric
_SIGMA0 = 0.001  # m, start
_LEAST = 1e-6  # m: made clouds have none
_STRAY_REACH0 = 0.015  # m, how far off the surface strays are looked for


@dataclass(frozen=True)
class SensorNoise:
    """Independent normal noise per axis, and strays: points pushed evenly up to `stray_reach` off, either way."""

    sigma: float  # m, per axis
    strays: float  # share of the points
    stray_reach: float  # m, along the normal

    def draw(self, surface: Surface, count: int, rng: np.random.Generator, offsets: Array | None = None) -> Array:
        """Return (count, 3) points [m] as this sensor would see the surface.

        offsets: (k,) m of its strays, by default as many as chance gives, even over the reach.
        """
        points, triangle = surface.sample(count, rng)
        points += self.sigma * rng.standard_normal((count, 3))
        if offsets is None:
            offsets = self.stray_reach * rng.uniform(-1, 1, rng.binomial(count, self.strays))
        points[: len(offsets)] += offsets[:, None] * surface.normals_of(triangle[: len(offsets)])
        return np.asarray(points)

    def stray_offsets(self, counts: Sequence[int], rng: np.random.Generator) -> list[Array]:
        """Return offsets [m] for draws of `counts` points: over all draws together as many strays as their share says
        and spread evenly; how they fall on the draws is chance. Few strays weigh much in an RMS: with chance in their
        number too, twenty draws of 1,500 points know their share to 10 %."""
        total = round(self.strays * sum(counts))
        strata = (np.arange(total) + rng.random(total)) / max(total, 1)
        offsets = self.stray_reach * rng.permutation(2 * strata - 1)
        fallen = rng.multivariate_hypergeometric(np.asarray(counts, dtype=np.int64), total)
        return np.split(offsets, np.cumsum(fallen)[:-1])


NOISE_FREE = SensorNoise(0.0, 0.0, 0.0)


def estimate_noise(frames: Sequence[Floats], thickness: float) -> SensorNoise:
    """Return the noise in clouds (n_t, 3) m of a cloth of known thickness [m], without any model of its shape.

    Around points drawn from the frames, the neighbours are a quadric sheet at plus or minus half the thickness, with
    normal noise of one sigma for all patches and an even background of strays: expectation-maximisation over faces
    and strays together with the patches' coefficients. A patch's six coefficients count as lost degrees of freedom.
    Sigma comes from the flatter half of the patches, where a quadric is shape enough (within 5 % of the truth on
    synthetic sheets at 0.3 to 1 mm). The share of strays comes from all points: those that lie alone, about 15 mm or
    more off, and those that the same expectation takes for strays of the sheet that their neighbours are without them;
    as many more hide in the noise as would if they are even. Raises InputError where no frame has enough points.
    """
    dense = [np.asarray(frame, dtype=np.float64) for frame in frames if len(frame) >= _NEIGHBOURS]
    if not dense:
        raise InputError(f"clouds of less than {_NEIGHBOURS} points: too few to estimate the sensor's noise")
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        around = [*threads.map(_Neighbours, dense)]
    half = thickness / 2
    most = -(-_PATCHES // len(dense))
    spread = [n.patches(np.linspace(0, len(n.index) - 1, min(most, len(n.index))).astype(int)) for n in around]
    sheets = _Sheets(np.concatenate(spread), half)
    depth = np.ptp(sheets.fitted, axis=1)
    flat = depth <= np.median(depth)
    sigma, strays = _SIGMA0, 0.01
    for _ in range(_ROUNDS):
        squared = sheets.expect(sigma, strays)
        mean = squared[flat].sum() / (sheets.weight[flat].sum() - _TERMS * flat.sum())
        last, sigma = sigma, max(float(np.sqrt(max(mean, 0.0))), _LEAST)
        strays = float(np.clip(1 - sheets.weight[:, 0].mean(), 1e-6, 0.5))
        if abs(sigma - last) < _CONVERGED * sigma:
            break
    hidden = _HIDDEN * sigma
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        strays_by_frame = threads.map(lambda n: _crowded_strays(n, half, sigma, strays), around)
        off = np.concatenate([*(n.alone[n.alone > hidden] for n in around), *strays_by_frame])
    if not len(off):
        return SensorNoise(sigma, 0.0, 0.0)
    # even ones are seen from `hidden` to the reach outwards, and to the thickness less inwards, off the other face
    reach = max(2 * float(off.mean()) - hidden + half, 2 * (hidden + half))
    return SensorNoise(sigma, len(off) / sum(map(len, dense)) / (1 - (hidden + half) / reach), reach)


class _Neighbours:
    """The points of a frame (n, 3) m that do not lie alone, each with its nearest ones; it comes first itself."""

    def __init__(self, frame: Array) -> None:
        distance, index = cKDTree(frame).query(frame, k=_NEIGHBOURS)
        index[:, 0] = np.arange(len(frame))  # a point that another one covers exactly still comes first
        lone = distance[:, 2] > _ALONE * distance[:, -1]  # a stray may have another one near
        self.frame, self.index = frame, index[~lone]  # (m, neighbours)
        self.alone = cKDTree(frame[~lone]).query(frame[lone])[0]  # m, how far the nearest of the others is

    def patches(self, rows: NDArray[np.intp] | slice) -> Array:
        """Return (rows, neighbours, 3) m, each in its own principal axes about its middle, the normal last."""
        patch = self.frame[self.index[rows]]
        patch = patch - np.median(patch, axis=1, keepdims=True)
        _, axes = np.linalg.eigh(patch.transpose(0, 2, 1) @ patch)
        return np.asarray(patch @ axes[:, :, ::-1])


class _Sheets:
    """Patches as two-faced quadrics. `expect` makes a round of expectation-maximisation.

    middle: whether the point that a patch lies around counts in its fit.
    """

    def __init__(self, patches: Array, half: float, *, middle: bool = True) -> None:
        x, y, z = np.moveaxis(patches, 2, 0)
        x, y = x / np.abs(x).max(), y / np.abs(y).max()
        self.basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)  # (n, neighbours, 6)
        self.z, self.half = z, half  # (n, neighbours) m; m, half the thickness
        self.counted = np.ones(patches.shape[1])  # (neighbours,) 0 where a point does not count in the fit, else 1
        self.counted[0] = middle
        self.weight = 1 / (1 + np.square(z / (2 * half + _SIGMA0)))  # (n, neighbours) how likely none of the strays
        self.fitted = _fitted(self.basis, z, self.weight * self.counted)  # (n, neighbours) m, the quadric
        self.face = np.where(z > self.fitted, 1.0, -1.0)  # (n, neighbours) expectation of its side, -1 to 1

    def expect(self, sigma: float, strays: float) -> Array:
        """Return (n, neighbours) m^2: weighted mean squares off the points' faces. sigma [m]; strays: share."""
        self.fitted = _fitted(self.basis, self.z - self.half * self.face, self.weight * self.counted)
        residual = self.z - self.fitted
        front, back = (np.exp(-0.5 * np.square((residual - s * self.half) / sigma)) for s in (1, -1))
        density = (1 - strays) * (front + back) / (2 * sigma * np.sqrt(2 * np.pi))
        self.weight = density / (density + strays / (2 * _STRAY_REACH0))
        self.face = (front - back) / np.maximum(front + back, 1e-300)
        squared = np.square(residual) - 2 * self.half * self.face * residual + self.half**2
        return np.asarray(self.weight * squared)

    def off(self) -> Array:
        """Return (n,) m from the middle point of a patch to its quadric."""
        return np.abs(self.z[:, 0] - self.fitted[:, 0])


def _crowded_strays(around: _Neighbours, half: float, sigma: float, strays: float) -> Array:
    """Return how far [m] off their faces the points lie that are strays and yet not alone."""
    every = around.patches(slice(None))
    off = _Sheets(every, half, middle=False).off()
    suspicious = off > half + _HIDDEN * sigma / 2  # the first fit is rough
    if not suspicious.any():
        return np.zeros(0)
    suspects = _Sheets(every[suspicious], half, middle=False)
    for _ in range(_SUSPECT_ROUNDS):
        suspects.expect(sigma, strays)
    # a middle point that does not count is known less well off its face, most of all at a hem
    at = suspects.basis[:, 0, :, None]
    _, matrix = _normal(suspects.basis, suspects.weight * suspects.counted)
    extrapolated = np.sqrt(1 + (at.transpose(0, 2, 1) @ np.linalg.solve(matrix, at))[:, 0, 0])
    off = np.abs(suspects.off() - half)
    return off[(suspects.weight[:, 0] < 0.5) & (off > _HIDDEN * sigma * extrapolated)]


def _fitted(basis: Array, z: Array, weight: Array) -> Array:
    """Return the values of each patch's weighted least-squares quadric."""
    weighted, matrix = _normal(basis, weight)
    return np.asarray((basis @ np.linalg.solve(matrix, weighted @ z[..., None]))[..., 0])


def _normal(basis: Array, weight: Array) -> tuple[Array, Array]:
    """Return the weighted basis (n, 6, neighbours) and the normal equations' matrix (n, 6, 6)."""
    weighted = (basis * weight[..., None]).transpose(0, 2, 1)
    return weighted, weighted @ basis + 1e-9 * np.eye(_TERMS)
