"""The sensor's noise as the measured clouds themselves show it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fabdesign.errors import InputError
from fabdesign.surface import Surface

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]

_NEIGHBOURS = 64  # in a patch: enough that its six coefficients and the faces do not absorb the noise
_PATCHES = 9_000  # at most, spread over the frames: 27 strays at a share of 0.3 %
_ROUNDS = 40  # at most
_CONVERGED = 1e-3  # of sigma, in a round
_ALONE = 0.5  # nearest neighbour over farthest of a patch: one point of a sheet in 10^8 has more
_SIGMA0 = 0.001  # m, start
_STRAY_REACH0 = 0.015  # m, how far off the surface strays are looked for


@dataclass(frozen=True)
class SensorNoise:
    """Independent normal noise per axis, and strays: points pushed evenly up to `stray_reach` off, either way."""

    sigma: float  # m, per axis
    strays: float  # share of the points
    stray_reach: float  # m, along the normal

    def draw(self, surface: Surface, count: int, rng: np.random.Generator) -> Array:
        """(count, 3) points [m] as this sensor would see the surface."""
        points, normals = surface.sample(count, rng)
        points += self.sigma * rng.standard_normal((count, 3))
        stray = rng.random(count) < self.strays
        offset = np.where(stray, self.stray_reach * rng.uniform(-1, 1, count), 0.0)
        return np.asarray(points + offset[:, None] * normals)


def estimate_noise(frames: Sequence[Floats], thickness: float) -> SensorNoise:
    """The noise in clouds (n_t, 3) m of a cloth of known thickness [m], without any model of its shape.

    Around points drawn from the frames, the neighbours are a quadric sheet at plus or minus half the thickness, with
    normal noise of one sigma for all patches and an even background of strays: expectation-maximisation over faces
    and strays together with the patches' coefficients. A patch's six coefficients count as lost degrees of freedom.
    A point that lies alone, about 15 mm or more off, is a stray without that: it would bend its patch to itself.
    Sigma comes from the flatter half of the patches, where a quadric is shape enough (within 5 % of the truth on
    synthetic sheets at 0.3 to 1 mm), the share of strays from the patches' centres and, of those alone, from all
    points. Raises InputError where no frame has enough points.
    """
    patches, alone, count = _patches(frames)
    x, y, z = np.moveaxis(patches, 2, 0)
    x, y = x / np.abs(x).max(), y / np.abs(y).max()
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)
    half, sigma, strays = thickness / 2, _SIGMA0, 0.01
    weight = 1 / (1 + np.square(z / (2 * half + _SIGMA0)))
    fitted = _fitted(basis, z, weight)
    face = np.where(z > fitted, 1.0, -1.0)  # expectation of the side, -1 to 1
    depth = np.ptp(fitted, axis=1)
    flat = depth <= np.median(depth)
    for _ in range(_ROUNDS):
        residual = z - _fitted(basis, z - half * face, weight)
        front, back = (np.exp(-0.5 * np.square((residual - s * half) / sigma)) for s in (1, -1))
        density = (1 - strays) * (front + back) / (2 * sigma * np.sqrt(2 * np.pi))
        weight = density / (density + strays / (2 * _STRAY_REACH0))
        face = (front - back) / np.maximum(front + back, 1e-300)
        squared = weight * (np.square(residual) - 2 * half * face * residual + half**2)
        last, sigma = sigma, float(np.sqrt(squared[flat].sum() / (weight[flat].sum() - basis.shape[2] * flat.sum())))
        strays = float(np.clip(1 - weight[:, 0].mean(), 1e-6, 0.5))
        if abs(sigma - last) < _CONVERGED * sigma:
            break
    near = np.abs(np.abs(residual[:, 0]) - half)[weight[:, 0] < 0.5]
    shares = [strays if len(near) else 0.0, len(alone) / count]
    if not any(shares):
        return SensorNoise(sigma, 0.0, 0.0)
    # the mean distance of even strays is half their reach; those lost among the noise lie below three sigma
    off = np.average([np.mean(x) if len(x) else 0.0 for x in (near, alone)], weights=shares)
    return SensorNoise(sigma, sum(shares), max(2 * float(off) - 3 * sigma, 0.0))


def _patches(frames: Sequence[Floats]) -> tuple[Array, Array, int]:
    """(patches, neighbours, 3): each patch in its own principal axes about its centre, the normal last; its first
    point is the one it was built around. The nearest neighbours' distances [m] of points that lie alone; of how many.
    """
    dense = [frame for frame in frames if len(frame) >= _NEIGHBOURS]
    if not dense:
        raise InputError(f"clouds of less than {_NEIGHBOURS} points: too few to estimate the sensor's noise")
    per_frame = -(-_PATCHES // len(dense))
    found, alone = [], []
    for frame in dense:
        distance, index = cKDTree(frame).query(frame, k=_NEIGHBOURS)
        index[:, 0] = np.arange(len(frame))  # a point that another one covers exactly still comes first
        lone = distance[:, 1] > _ALONE * distance[:, -1]
        alone.append(distance[lone, 1])
        others = np.flatnonzero(~lone)
        centres = others[np.linspace(0, len(others) - 1, min(per_frame, len(others))).astype(int)]
        patch = np.asarray(frame, dtype=np.float64)[index[centres]]
        patch = patch - np.median(patch, axis=1, keepdims=True)
        _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", patch, patch))
        found.append(patch @ axes[:, :, ::-1])
    return np.concatenate(found), np.concatenate(alone), sum(map(len, dense))


def _fitted(basis: Array, z: Array, weight: Array) -> Array:
    """Values of each patch's weighted least-squares quadric."""
    weighted = (basis * weight[..., None]).transpose(0, 2, 1)
    coefficients = np.linalg.solve(weighted @ basis + 1e-9 * np.eye(basis.shape[2]), weighted @ z[..., None])
    return np.asarray((basis @ coefficients)[..., 0])
