"""Ripple of stereo depth: an error of one period a pixel of disparity, since a match leans to whole pixels.

It is a function of the inverse depth, w' = w + a sin(2 pi k w) + b cos(2 pi k w), the same in all images of a camera; k
is its focal length times its baseline. The cloth is smooth: what local planes leave of it shows k, a and b, and then w
follows from w'. Of several w that have one w', which large ripple makes, that next to the local plane is taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from fabdesign.nouns.array import Array

WIDE = 0.036  # m, side of the window of a local plane: more than a period of ripple on a cloth seen obliquely
BASELINES = np.geomspace(0.03, 0.13, 26)  # m
NOISE = 0.04  # pixels of disparity
FOLDS = 0.8 / (2 * np.pi)  # pixels, amplitude beyond which several depths look alike
TRUST = ((1.0, 0.15), (0.6, 0.1), (0.36, 0.06))  # where it folds: of WIDE, and pixels that the local plane is off
REACH, TRIED = 0.7, 29  # pixels from the local plane, and depths within that are tried
EXACT = 1e-4  # pixels, a step so short is the last one
JUMP = 0.06  # 1/m, of two surfaces
LEAST_SHARE, LEAST_RATIO = 0.1, 10.0  # of the residuals' square that is ripple, and over that of other baselines
ROUNDS = 3
LOCAL = 0.15  # of the baseline's logarithm, that it moves from the best of BASELINES at most: else it is no peak
RIPPLE_IMAGES = 3  # that show a camera's ripple


@dataclass(frozen=True)
class Ripple:
    """An error that a camera adds to inverse depths."""

    frequency: float  # k, m
    sine: float  # a, 1/m
    cosine: float  # b, 1/m
    focal: float  # pixels
    pixel: float  # m on the cloth
    share: float = 1.0  # of the square of what local planes leave

    @property
    def disparity(self) -> float:
        """Return the amplitude in pixels of disparity."""
        return float(np.hypot(self.sine, self.cosine)) * self.frequency

    @property
    def depth(self) -> float:
        """Return the amplitude [m] at the cloth's middle."""
        return float(np.hypot(self.sine, self.cosine)) * (self.focal * self.pixel) ** 2

    def without(self, depth: Array) -> Array:
        """Return the depths (rows, columns) m without it; 0 stays 0."""
        there = depth > 0
        w = 1.0 / np.where(there, depth, 1.0)
        if self.disparity < FOLDS:
            least = self._nearest(w, w, w, 0.0)
        else:
            least = w
            for share, trust in TRUST:
                plane, pull = _Planes(there, share * WIDE / self.pixel).smooth(least), (NOISE / trust) ** 2
                tried = plane + REACH / self.frequency * np.linspace(-1.0, 1.0, TRIED)[:, None, None]
                cost = (tried + self._wave(tried)[0] - w) ** 2 + pull * (tried - plane) ** 2
                start = np.take_along_axis(tried, cost.argmin(axis=0)[None], axis=0)[0]
                least = self._nearest(w, plane, start, pull)
        return np.where(there, 1.0 / np.where(there, least, 1.0), 0.0)

    def _wave(self, w: Array) -> tuple[Array, Array]:
        """Return what it adds to inverse depths, and that one's slope."""
        turn = 2 * np.pi * self.frequency
        sine, cosine = np.sin(turn * w), np.cos(turn * w)
        return self.sine * sine + self.cosine * cosine, turn * (self.sine * cosine - self.cosine * sine)

    def _nearest(self, seen: Array, plane: Array, start: Array, pull: float) -> Array:
        """Return the inverse depths by `start` that look as they were seen; pull: how much the plane counts."""
        least, going = start, np.ones(start.shape, dtype=bool)
        for _ in range(4):  # Gauss-Newton
            wave, slope = self._wave(least)
            slope = slope + 1.0
            step = (slope * (least + wave - seen) + pull * (least - plane)) / (slope**2 + pull)
            least = least - going * np.clip(step, -0.03 / self.frequency, 0.03 / self.frequency)
            going &= np.abs(step) >= EXACT / self.frequency
        return least


def ripple_of(depths: Sequence[Array], focal: float, pixel: float) -> Ripple | None:
    """Return the ripple of a camera in some of its images (rows, columns) m of the cloth; None where they show none.

    focal: pixels. pixel: m on the cloth.
    """
    coarser = 2.0 * pixel  # every second pixel shows it as well
    images = [_Residuals(depth[::2, ::2], WIDE / coarser) for depth in depths]
    shares = np.array([_fit(images, focal * baseline, focal)[0].share for baseline in BASELINES])
    if shares.max() < LEAST_RATIO * np.median(shares):
        return None
    frequency = begin = focal * float(BASELINES[shares.argmax()])
    for _ in range(ROUNDS):
        ripple, change = _fit(images, frequency, focal, coarser)
        frequency += change
        for image in images:
            image.phase_by(ripple)
    ripple, _ = _fit(images, frequency, focal, pixel)
    return ripple if ripple.share > LEAST_SHARE and abs(np.log(frequency / begin)) < LOCAL else None


class _Planes:
    """Planes through the pixels that are there in a square window about each, by least squares."""

    def __init__(self, there: NDArray[np.bool_], size: float) -> None:
        self._there, self._size = there, 2 * max(round(size / 2), 1) + 1
        self.filled = uniform_filter(there.astype(float), self._size, mode="constant")
        self._places = [np.where(there, x, 0.0) for x in np.indices(there.shape, dtype=float)]
        self._middle = [self._mean(x) for x in self._places]
        (r, c), (mr, mc) = self._places, self._middle
        self._spread = self._mean(r * r) - mr**2, self._mean(c * c) - mc**2, self._mean(r * c) - mr * mc
        rr, cc, rc = self._spread
        self._det = np.maximum(rr * cc - rc**2, 1e-6 * np.maximum(rr * cc, 1.0))

    def _mean(self, x: Array) -> Array:
        return np.asarray(uniform_filter(x, self._size, mode="constant") / np.maximum(self.filled, 1e-9))

    def smooth(self, x: Array) -> Array:
        """Return the planes' values at the pixels, and those of what they leave: so curvature stays."""
        once = self._once(x)
        return once + self._once(x - once)

    def _once(self, x: Array) -> Array:
        x = np.where(self._there, x, 0.0)
        (r, c), (mr, mc), (rr, cc, rc) = self._places, self._middle, self._spread
        mean = self._mean(x)
        xr, xc = self._mean(x * r) - mr * mean, self._mean(x * c) - mc * mean
        along = (xr * cc - xc * rc) * (r - mr) + (xc * rr - xr * rc) * (c - mc)
        return np.where(self._there, mean + along / self._det, 0.0)


class _Residuals:
    """The rest that local planes leave of one image's inverse depths."""

    def __init__(self, depth: Array, size: float) -> None:
        there = depth > 0
        self._depth, self.planes = depth, _Planes(there, size)
        w = 1.0 / np.where(there, depth, 1.0)
        self.phase = self.planes.smooth(w)
        self.kept = there & (self.planes.filled > 0.5) & (np.abs(w - self.phase) < JUMP)
        self.values = (w - self.phase)[self.kept]

    def phase_by(self, ripple: Ripple) -> None:
        """Take inverse depths without the ripple for those at which it is looked up."""
        depth = ripple.without(self._depth)
        self.phase = _Planes(depth > 0, 0.36 * WIDE / ripple.pixel).smooth(1.0 / np.where(depth > 0, depth, 1.0))

    def column(self, values: Array) -> Array:
        """Return what local planes leave of other values (rows, columns)."""
        return (values - self.planes.smooth(values))[self.kept]


def _fit(images: Sequence[_Residuals], frequency: float, focal: float, pixel: float = 0.0) -> tuple[Ripple, float]:
    """Return the ripple of a frequency, and how that is better changed, which is not sought without a pixel [m]."""
    waves = [2 * np.pi * frequency * image.phase for image in images]

    def column(values: Sequence[Array]) -> Array:
        return np.concatenate([image.column(each) for image, each in zip(images, values, strict=True)])

    seen = np.concatenate([image.values for image in images])
    sound = np.abs(seen) < 4.0 * 1.48 * np.median(np.abs(seen))
    seen, rows = seen[sound], [column([wave(w) for w in waves])[sound] for wave in (np.sin, np.cos)]
    (sine, cosine), *_ = np.linalg.lstsq(np.array(rows).T, seen, rcond=None)
    residual = seen - sine * rows[0] - cosine * rows[1]
    change = 0.0
    if pixel:
        places = [image.phase - image.phase[image.kept].mean() for image in images]
        later = [2 * np.pi * x * (sine * np.cos(w) - cosine * np.sin(w)) for x, w in zip(places, waves, strict=True)]
        change = float(np.linalg.lstsq(np.array([*rows, column(later)[sound]]).T, residual, rcond=None)[0][2])
    share = 1.0 - float(residual @ residual) / max(float(seen @ seen), 1e-30)
    return Ripple(frequency, float(sine), float(cosine), focal, pixel, share), change
