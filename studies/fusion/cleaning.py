"""Cleaning of one depth image or cloud: the local plane of each pixel's window, robust, tells the surface from what
flies beside it; its value at the pixel is smoother than the pixel's own.

A plane is linear in the inverse depth over the slopes of the rays, so that each fit is a small linear one. Every second
pixel or so is fitted, in a window of fixed size on the cloth. A cloud is laid on the raster of its own rays.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fabdesign.nouns.array import Array

WINDOW = 0.005  # m, half the side of the window
SPACING = 0.003  # m between fitted pixels
LEAST_SUPPORT = 0.35  # of a window, on the plane; a border that is straight has half of it
GATE = 0.015  # m of depth within a window's half side, beyond which it is another surface
NOISE = 6e-4  # m, least scale of the robust fit
OFF_PLANE, LEAST_OFF = 4.0, 0.003  # scales, m: a pixel beyond is no measurement of the surface
ROUNDS = 3
MOST_HALF = 8  # pixels
GRAZING = np.cos(np.radians(82.0))  # a surface seen flatter than this is a ribbon between two surfaces
MOST_CELLS = 4_200_000  # of a cloud's raster


@dataclass(frozen=True, eq=False)
class Cleaned:
    """Points (n, 3) m and unit normals towards the camera, in the camera's frame."""

    points: Array
    normals: Array
    dropped: int
    cells: NDArray[np.intp]  # (n, 2) row and column in a raster of its image

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(self.points)


@dataclass(frozen=True)
class ImageFilter:
    """Which filters are on; without them every second pixel stands as it was measured."""

    smooth: bool = True  # the plane's depth in place of the pixel's
    flying: bool = True  # what leaves the plane goes


FILTERS = ImageFilter()


def clean_image(
    depth: Array, slopes: Array, pixel: float, corner: tuple[int, int] = (0, 0), filters: ImageFilter = FILTERS
) -> Cleaned:
    """Return the surface points of a depth image (rows, columns) m, 0 where there is none, or of a part of one.

    slopes: (rows, columns, 2) of its pixels. pixel: m on the cloth, the same for all images of a camera. corner: row
    and column of the part's first pixel in the camera's image.
    """
    half = int(np.clip(round(WINDOW / pixel), 1, MOST_HALF))
    step = max(1, round(SPACING / pixel))
    first = -corner[0] % step, -corner[1] % step  # the same pixels whatever the part
    fitted = _fit(depth, slopes[..., 0], slopes[..., 1], half, step, first)
    kept = fitted[..., 0] > 0
    rows, columns = np.nonzero(kept)
    plane = fitted[rows, columns]
    at = rows * step + first[0], columns * step + first[1]
    single = depth[at]
    z = 1.0 / plane[:, 0] if filters.smooth else single
    ray = np.concatenate([slopes[at], np.ones((len(z), 1))], axis=1)
    normal = plane[:, 1:4] / np.linalg.norm(plane[:, 1:4], axis=1, keepdims=True)
    towards = -np.einsum("ni,ni->n", ray, normal) / np.linalg.norm(ray, axis=1)
    normal *= np.where(towards < 0, -1.0, 1.0)[:, None]
    sound = np.abs(towards) > GRAZING
    if filters.flying:
        sound &= (plane[:, 4] > LEAST_SUPPORT) & (np.abs(single - 1.0 / plane[:, 0]) < plane[:, 5])
    every = int((depth[first[0] :: step, first[1] :: step] > 0).sum())
    cells = np.stack([(at[0] + corner[0]) // step, (at[1] + corner[1]) // step], axis=1)[sound]
    points = (ray * z[:, None])[sound]
    return Cleaned(points, normal[sound], every - int(sound.sum()), cells)


def clean(cloud: Array) -> Cleaned:
    """Return the surface points of a camera's cloud (n, 3) m, z forward."""
    return clean_image(*raster(cloud)[:3])


class Raster(NamedTuple):
    """A cloud as an image by its own raster."""

    depth: Array  # (rows, columns) m
    slopes: Array  # of the rays
    pixel: float  # m, the width of a cell on the cloth
    focal: float  # cells


def raster(cloud: Array) -> Raster:
    """Return a cloud's raster; of two points on one cell the nearer counts."""
    slope = cloud[:, 1::-1] / cloud[:, 2:]  # row first
    nearest, _ = cKDTree(slope).query(slope, k=min(5, len(slope)))  # on a raster four lie a pixel away
    low, spread = slope.min(axis=0), np.ptp(slope, axis=0)
    pitch = max(float(np.median(nearest[..., -1])), (float(spread.prod()) / MOST_CELLS) ** 0.5, 1e-6)
    cell = np.round((slope - low) / pitch).astype(np.intp)
    order = np.argsort(-cloud[:, 2], kind="stable")
    depth = np.zeros(cell.max(axis=0) + 1)
    slopes = np.zeros((*depth.shape, 2))
    depth[tuple(cell[order].T)] = cloud[order, 2]
    slopes[tuple(cell[order].T)] = slope[order, ::-1]
    return Raster(depth, slopes, pitch * float(np.median(cloud[:, 2])), 1.0 / pitch)


@njit(cache=True)
def _fit(
    depth: Array, slope_x: Array, slope_y: Array, half: int, step: int, first: tuple[int, int]
) -> Array:  # pragma: no cover - compiled
    """Return for each fitted pixel: inverse depth [1/m] of its window's plane there, the plane (n over its distance),
    the share of the window on it, and how far [m] the pixel may be off; 0 where there is no plane."""
    rows, columns = depth.shape
    height = (rows - first[0] + step - 1) // step
    width = (columns - first[1] + step - 1) // step
    out = np.zeros((max(height, 0), max(width, 0), 6))
    window = (2 * half + 1) ** 2
    w = np.empty(window)
    x = np.empty(window)
    y = np.empty(window)
    weight = np.empty(window)
    for i in range(height):
        for j in range(width):
            r, c = first[0] + i * step, first[1] + j * step
            z0 = depth[r, c]
            if z0 <= 0.0:
                continue
            sx, sy, w0 = slope_x[r, c], slope_y[r, c], 1.0 / z0
            n = 0
            for rr in range(max(0, r - half), min(rows, r + half + 1)):
                for cc in range(max(0, c - half), min(columns, c + half + 1)):
                    z = depth[rr, cc]
                    if z > 0.0 and abs(z - z0) < GATE:
                        w[n] = 1.0 / z - w0
                        x[n] = slope_x[rr, cc] - sx
                        y[n] = slope_y[rr, cc] - sy
                        weight[n] = 1.0
                        n += 1
            if n < 6:
                continue
            scale = NOISE / z0**2
            a = b = e = 0.0
            sound = True
            for turn in range(ROUNDS):
                s = sxx = syy = sxy = s_x = s_y = sw = swx = swy = 0.0
                for k in range(n):
                    g = weight[k]
                    s += g
                    s_x += g * x[k]
                    s_y += g * y[k]
                    sxx += g * x[k] * x[k]
                    syy += g * y[k] * y[k]
                    sxy += g * x[k] * y[k]
                    sw += g * w[k]
                    swx += g * w[k] * x[k]
                    swy += g * w[k] * y[k]
                mx, my, mw = s_x / s, s_y / s, sw / s
                cxx, cyy, cxy = sxx / s - mx * mx, syy / s - my * my, sxy / s - mx * my
                dx, dy = swx / s - mw * mx, swy / s - mw * my
                det = cxx * cyy - cxy * cxy
                if det <= 1e-4 * cxx * cyy or det <= 0.0:
                    sound = False
                    break
                b = (dx * cyy - dy * cxy) / det
                e = (dy * cxx - dx * cxy) / det
                a = mw - b * mx - e * my
                total = 0.0
                for k in range(n):
                    off = w[k] - a - b * x[k] - e * y[k]
                    total += min(off * off, 9.0 * scale * scale) if turn else off * off
                scale = max(NOISE / z0**2, min((total / n) ** 0.5, 3.0 * NOISE / z0**2))
                for k in range(n):
                    off = (w[k] - a - b * x[k] - e * y[k]) / (2.0 * scale)
                    weight[k] = 1.0 / (1.0 + off * off)
            if not sound or a + w0 <= 0.0:
                continue
            held = 0
            for k in range(n):
                if abs(w[k] - a - b * x[k] - e * y[k]) < 3.0 * scale:
                    held += 1
            out[i, j, 0] = a + w0
            out[i, j, 1], out[i, j, 2] = b, e
            out[i, j, 3] = a + w0 - b * sx - e * sy
            out[i, j, 4] = held / window
            out[i, j, 5] = max(LEAST_OFF, OFF_PLANE * scale * z0**2)
    return out
