"""Residuals of a model, point by point or row by row, and the limits on what one of them can do."""

from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.surface import CAP
from fabdesign.nouns.array import Array, Indices

FAR = 2.0  # times the usual median residual: an outlying frame, which counts less


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
        """Return the robust standard deviation."""
        return max(deviation_by_median(residual), self.smallest)

    def share(self, residual: Array, scale: float) -> Array:
        """Return how much each residual (N,) counts (Huber's weights), 0 to 1."""
        return np.minimum(1.0, self.huber * scale / np.maximum(np.abs(residual), 1e-12))

    def of(self, t: Array) -> Array:
        """Return the -log likelihood (N,) of residuals in units of their scale (Huber's function)."""
        size = np.abs(t)
        return np.where(size <= self.huber, 0.5 * t * t, self.huber * (size - 0.5 * self.huber))


CLOUDS = Loss()
ROWS = Loss(far=np.inf, stray=np.inf, largest=np.inf, cap=np.inf, smallest=1e-12)  # of a bench, in its output's unit


@dataclass(frozen=True, eq=False)
class Misfit:
    """How far the model is off at N points of clouds or rows of a bench's records, all samples in a row."""

    residual: Array  # (N,) m, or in the bench's unit; NaN in frames that the model has lost
    sample: Indices  # (N,) of which trial, shape or record
    frame: Indices  # (N,) within its sample
    block: Indices  # (N,) which of them share the model's error
    _: KW_ONLY
    loss: Loss = CLOUDS

    @property
    def rms(self) -> float:
        """Return the capped RMS, m."""
        return capped(self.residual, self.loss.cap)


def frames_of(misfit: Misfit, rows: NDArray[np.bool_] | slice = slice(None)) -> tuple[Indices, list[Indices]]:
    """Return the frame of each of the points `rows`, counted among themselves, and the points of each frame."""
    _, frame = np.unique(misfit.sample[rows] * 100_000 + misfit.frame[rows], return_inverse=True)
    return frame, groups_of(frame)


def groups_of(cluster: Indices) -> list[Indices]:
    """Return the rows of each cluster."""
    return np.split(np.argsort(cluster, kind="stable"), np.cumsum(np.bincount(cluster))[:-1])


def not_strays(misfit: Misfit) -> NDArray[np.bool_]:
    """Return which points (N,) are there and not much farther off than the others of their frame."""
    size = np.abs(misfit.residual)
    kept = np.isfinite(size)
    for points in frames_of(misfit)[1]:
        sizes = size[points]
        if np.isfinite(sizes).all():
            kept[points] = sizes <= misfit.loss.stray * max(deviation_by_median(sizes), 1e-4)
    return kept


def deviation_by_median(residual: Array) -> float:
    """Return the standard deviation of normal noise whose sizes have this median."""
    return 1.4826 * float(np.median(np.abs(residual)))


def capped(residual: Array, cap: float = CAP) -> float:
    """Return the RMS of what is not lost, m."""
    kept = residual[np.isfinite(residual)]
    return float(np.sqrt(np.mean(np.square(np.clip(kept, -cap, cap))))) if len(kept) else float("nan")
