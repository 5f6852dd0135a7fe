"""Checks that every measured cloud passes before anything computes with it; what a sensor adds to one is left out.

A depth sensor writes NaN, pixels without depth at its own origin, and now and then a point far away. Up to half of a
frame is left out for that, counted and said; where more would go, the frame is refused.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError, note
from fabdesign.formats.lab_table import parse_heading

Points = NDArray[np.float64]

LONGEST_HEADER = 65536  # bytes, of a file of points
_FAR = 10.0  # cloth sizes; a cloud so far off is in another unit, not badly placed
_CENTIMETRES = 100.0  # cloth sizes, below which hundredths are likelier than thousandths
_BEYOND = 3.0  # cloth sizes from the middle of the cloud: no point of the cloth
_ALONE = 100.0  # median distances from the middle, beyond which no shape's own points lie, where no size is known
_FULL = 0.97  # of the range of integers
_MANY = 200  # points of a cloud, no markers, of which some lie between its ends
_INSTANTS = {"frame", "frames", "time", "t", "timestamp", "zeit", "step", "bild", "scan"}  # when a point was there
_ORDERED = 0.8  # of a depth image's variance along some direction, which its rows, and its columns, tell apart
_LARGEST = 1e5  # of a coordinate in any unit: 100 m in millimetres
_REPEATED, _REPEATED_SHARE = 8, 0.01  # points at exactly one place, which a measured surface never has

_REMOVED = ("not finite", "without depth", "far off")  # at the sensor's origin: without depth


def refuse(path: Path, why: str) -> NoReturn:
    """Raise InputError for a file that is not as its kind has it."""
    raise InputError(f"{path}: {why}; expected a sound {path.suffix[1:].upper()}")


def note_removed(removed: NDArray[np.intp], of: int, where: str) -> None:
    """Say what was left out of so many points; nothing where nothing was."""
    if removed.any():
        note(f"{where}: {removed.sum()} of {of} points are left out ({_removed_in_words(removed)})")


def _removed_in_words(removed: NDArray[np.intp]) -> str:
    return ", ".join(f"{count} {what}" for count, what in zip(removed, _REMOVED, strict=True) if count)


def sound_cloud(points: NDArray[Any], where: str, *, size: float | None = None, unit_known: bool = True) -> Points:
    """Return the points of `sound_points`; say which are left out."""
    kept, removed = sound_points(points, where, size=size, unit_known=unit_known)
    note_removed(removed, points.size // 3, where)
    return kept


def sound_points(
    points: NDArray[Any], where: str, *, size: float | None = None, unit_known: bool = True
) -> tuple[Points, NDArray[np.intp]]:
    """Return the points of a cloud (n, 3) m, or of a depth image (rows, columns, 3), that can be the cloth's, and how
    many others there were, (3,) as _REMOVED.

    size: the cloth's longer side [m]; without one, only what is far off by the cloud's own measure goes. unit_known:
    False of a file that may be in another unit than m. Raises InputError where integers wrapped, where an image is
    none, as `require_cloud` does, and where more than half would be left out.
    """
    if points.ndim == 3:
        _require_image(points, where)
        points = points.reshape(-1, 3)
    require_room(points, where)
    points = points.astype(np.float64, copy=False)
    _require_points(points, where)
    finite = np.isfinite(points).all(axis=1)
    depth = _have_depth(points) | ~finite
    kept = finite & depth
    close = np.ones(len(points), dtype=bool)
    if kept.any():
        with np.errstate(over="ignore"):  # far is far
            off = np.linalg.norm(points - np.median(points[kept], axis=0), axis=1)
        far = kept & (off > (_BEYOND * size if size is not None else _ALONE * np.median(off[kept])))
        if far.sum() <= len(points) / 2:  # else it is the unit: `require_cloud` says so
            close = ~far
    removed = np.array([(~sound).sum() for sound in (finite, depth, close)])
    if 2 * removed.sum() > len(points):
        raise InputError(
            f"{where}: of {len(points)} points {_removed_in_words(removed)}; expected at least half of them sound"
        )
    points = points[kept & close]
    require_cloud(points, where, size=size if unit_known else np.inf)
    return points, removed


def require_cloud(points: Points, where: str, *, size: float | None = None) -> None:
    """Raise InputError unless `points` is an (n, 3) cloud in m with n > 0 and finite coordinates.

    size: the cloth's longer side [m], 1 m where it is not known; a cloud ten times as far away is taken to be in
    another unit; one with a coordinate of over 1e5 is none, whatever its unit.
    """
    _require_points(points, where)
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        raise InputError(f"{where}: {int(bad.sum())} of {len(points)} points are not finite; expected metres")
    largest = float(np.abs(points).max())
    if not largest <= _LARGEST:
        raise InputError(f"{where}: a coordinate is {largest:.4g}; expected at most {_LARGEST:g} in any unit")
    distance = float(np.median(np.linalg.norm(points, axis=1)))
    if distance > _FAR * (size or 1.0):
        unit = "centimetres" if size is not None and distance < _CENTIMETRES * size else "millimetres"
        raise InputError(
            f"{where}: points lie {distance:.0f} m from the cloth's top edge; expected metres (is it in {unit}?)"
        )


def require_room(points: NDArray[Any], where: str) -> None:
    """Raise InputError where integers fill their range on two axes or more, or lie at both ends of it with nothing in
    the middle on one: numbers that did not fit and came out at the other end. A cloth hangs below its edge, so signed
    ones cannot fill both sides of zero."""
    if points.dtype.kind not in "iu" or points.dtype.itemsize > 2 or points.ndim != 2 or not len(points):
        return
    least, most = (int(end) for end in (np.iinfo(points.dtype).min, np.iinfo(points.dtype).max))
    margin, quarter = (1 - _FULL) * (most - least) / 2, (most - least) / 4
    filled = (points.max(axis=0) > most - margin) & (points.min(axis=0) < least + margin)
    parted = (len(points) >= _MANY) & filled & ~((points > least + quarter) & (points < most - quarter)).any(axis=0)
    if (points.dtype.kind == "i" and filled.sum() >= 2) or parted.any():
        axes = " and ".join(axis for axis, full in zip("xyz", filled, strict=False) if full)
        raise InputError(
            f"{where}: points fill the range of {points.dtype}, {points.min()} to {points.max()}, in {axes}; expected "
            "room (did they wrap? a larger scale)"
        )


def names_instants(name: str) -> bool:
    """Return whether a column or array of that name says when a point was there: `frame`, `Frame #`, `time_s`."""
    return re.sub(r"[^a-z]+|nr$|no$|number|index|idx|id$", "", parse_heading(name).name) in _INSTANTS


def require_one_instant(columns: Mapping[str, NDArray[Any]], where: str) -> None:
    """Raise InputError where the values of a column that `names_instants` differ: its points are of several frames."""
    for name, values in columns.items():
        if names_instants(name) and values.size and (values != values.flat[0]).any():
            raise InputError(f"{where}: its points are of several instants ({name}); expected those of one")


def _require_image(image: NDArray[Any], where: str) -> None:
    """Raise InputError unless (rows, columns, 3) can be a depth image, whose rows lie beside each other, as do its
    columns. Frames of a cloud, (frames, points, 3), lie on each other: they would be read as one cloud."""
    points = image.astype(np.float64)
    sound = (np.abs(points) <= _LARGEST).all(axis=2) & points.any(axis=2)
    if min(image.shape[:2]) < 2 or sound.sum() < _REPEATED:
        return
    kept = points[sound] - points[sound].mean(axis=0)
    total = kept.T @ kept
    if not total.any():  # all at one place, which are no points
        return
    axes = np.linalg.eigh(total)
    wide = axes.eigenvalues > 1e-6 * axes.eigenvalues[-1]
    scaled = kept @ (axes.eigenvectors[:, wide] / np.sqrt(axes.eigenvalues[wide]))
    for lines in np.nonzero(sound):
        sums = np.stack([np.bincount(lines, column) for column in scaled.T], axis=1)
        counts = np.maximum(np.bincount(lines), 1)
        separation = float(np.linalg.eigvalsh(sums.T @ (sums / counts[:, None]))[-1])
        if separation < _ORDERED:
            raise InputError(
                f"{where}: is {image.shape}, whose rows or columns lie on each other; expected points (n, 3) of one "
                "frame, or a depth image (are they frames?)"
            )


def _require_points(points: Points, where: str) -> None:
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{where}: points of shape {points.shape}; expected (n, 3)")
    if len(points) == 0:
        raise InputError(f"{where}: the cloud is empty; expected points")


def _have_depth(points: Points) -> NDArray[np.bool_]:
    """Return (n,) False where a pixel has none: two and more points at the file's origin, or many at another place."""
    origin: NDArray[np.bool_] = np.logical_not(points.any(axis=1))
    without = origin if origin.sum() >= 2 else np.zeros(len(points), dtype=np.bool_)
    many = max(_REPEATED, round(_REPEATED_SHARE * len(points)))
    x = np.sort(points[:, 0])
    if (x[many - 1 :] == x[: max(len(x) - many + 1, 0)]).any():
        order = np.lexsort(points.T)  # ten times as fast as numpy's unique rows
        rows = points[order]
        begins = np.concatenate([[0], 1 + np.flatnonzero((rows[1:] != rows[:-1]).any(axis=1)), [len(rows)]])
        counts = np.diff(begins)
        without[order[np.repeat(counts >= many, counts)]] = True
    return np.logical_not(without)
