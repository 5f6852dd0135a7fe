"""Intrinsics of a depth camera: from pixels to rays, by all distortion models of the RealSense SDK, of ROS and of Azure
Kinect.

Deprojection follows the SDK's own (librealsense, rsutil: Newton and fixed-point rounds) and is checked against it in
tests/clouds/test_depth_files.py. The SDK's deprojection is not the inverse of its own projection for Modified
Brown-Conrady (it leaves the distortion away) and for f-theta (its scale is another one); there a ray is the one whose
projection by the SDK is the pixel.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Literal, get_args

import numpy as np

from fabdesign.errors import InputError
from fabdesign.formats.toml_file import parsing
from fabdesign.nouns.array import Array

Model = Literal["none", "brown_conrady", "inverse_brown_conrady", "modified_brown_conrady", "ftheta", "kannala_brandt4"]
MOST_PIXELS = 4_200_000  # of an image: 2048 x 2048
_ROUNDS = 60  # of the fixed point; the SDK takes 10, which agrees to 1e-6 for the lenses that it has
_MOST_SLOPE = 20.0  # of a ray; beyond, it is no pixel of a camera
_ROS_MODELS: Mapping[str, Model] = {
    "": "none",
    **dict.fromkeys(("plumb_bob", "rational_polynomial"), "brown_conrady"),
    **dict.fromkeys(("equidistant", "fisheye"), "kannala_brandt4"),
}


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """A pinhole camera with distortion; lengths in pixels, pixel (0, 0) is the middle of the image's upper left one.

    coefficients: k1, k2, p1, p2, k3 of the Brown-Conrady models (and k4, k5, k6 of a rational polynomial), k1 to k4 of
    Kannala-Brandt, the angle of f-theta.
    """

    width: int
    height: int
    focal: tuple[float, float]
    centre: tuple[float, float]
    model: Model = "none"
    coefficients: tuple[float, ...] = ()

    @cached_property
    def slopes(self) -> Array:
        """Return (height, width, 2) x / z and y / z of each pixel's ray, y down."""
        u, v = np.meshgrid(np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64))
        return self.slopes_of(np.stack([u, v], axis=-1))

    def slopes_of(self, pixels: Array) -> Array:
        """Return (..., 2) slopes of pixels (..., 2), column and row."""
        return self._bent((pixels - np.array(self.centre)) / np.array(self.focal), 1)

    def pixels_of(self, slopes: Array) -> Array:
        """Return (..., 2) pixels of slopes (..., 2)."""
        return np.asarray(self._bent(slopes, 0) * np.array(self.focal) + np.array(self.centre))

    def _bent(self, slopes: Array, way: int) -> Array:
        """Return slopes (..., 2) as the lens bends them (0), or as it has not bent them (1)."""
        bends = self.model != "none" and any(self.coefficients)
        return _LENSES[self.model][way](slopes, np.array(self.coefficients)) if bends else slopes

    def __post_init__(self) -> None:
        """Raise InputError for what is no camera."""
        sizes = self.width > 0 and self.height > 0 and self.width * self.height <= MOST_PIXELS
        numbers = (*self.focal, *self.centre, *self.coefficients)
        slopes = np.array([self.width, self.height]) / np.maximum(np.abs(self.focal), 1e-9)
        if not sizes or not np.isfinite(numbers).all() or min(self.focal) <= 0 or slopes.max() > _MOST_SLOPE:
            raise InputError(
                f"intrinsics of {self.width} x {self.height} pixels, focal length {self.focal[0]:.4g}, "
                f"{self.focal[1]:.4g}; expected an image of at most {MOST_PIXELS / 1e6:.1f} million pixels, and pixels"
            )


def intrinsics_of(
    size: tuple[int, ...], matrix: Sequence[float], name: str, coefficients: Sequence[float], where: str
) -> Intrinsics:
    """Return intrinsics from a size (width, height), fx, fy, cx, cy, and the name of a model as the SDK or ROS has it.
    Raises InputError, `where` in its message."""
    plain = "_".join(name.lower().replace("-", " ").split())
    model = _ROS_MODELS.get(plain, plain)
    if model not in get_args(Model):
        raise InputError(f"{where}: distortion model {name[:40]!r}; expected one of {', '.join(get_args(Model))}")
    if len(coefficients) > 14:
        raise InputError(f"{where}: has {len(coefficients)} coefficients of distortion; expected at most 14")
    values = tuple(float(c) for c in coefficients)
    if any(values[8:]):
        raise InputError(f"{where}: has thin prism or tilt coefficients of distortion; expected none")
    try:
        fx, fy, cx, cy = (float(x) for x in matrix)
        return Intrinsics(int(size[0]), int(size[1]), (fx, fy), (cx, cy), model, values[:8])  # type: ignore[arg-type]
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: intrinsics are no numbers; expected width, height, focal length, centre") from None


def intrinsics_of_json(content: Any, size: tuple[int, ...] | None, where: str) -> Intrinsics:
    """Return the depth camera of a JSON for images of a size (width, height). Raises InputError.

    It is Open3D's pinhole camera or its Azure Kinect's `intrinsic_matrix`, the Azure Kinect SDK's raw calibration, or
    has keys as the RealSense SDK names them.
    """
    expected = "width, height and intrinsic_matrix, or fx, fy, ppx and ppy"
    with parsing(where, "holds no intrinsics", expected):  # a JSON of another form may hold anything
        if "CalibrationInformation" in content:
            return _azure_kinect(content["CalibrationInformation"]["Cameras"], size, where)
        if "intrinsic_matrix" in content:  # column by column
            m = [float(x) for x in content["intrinsic_matrix"]]
            matrix: tuple[float, ...] = (m[0], m[4], m[6], m[7])
            return intrinsics_of((content["width"], content["height"]), matrix, "none", (), where)
        keys = (("fx", "fx"), ("fy", "fy"), ("ppx", "cx"), ("ppy", "cy"))
        matrix = tuple(content[k] if k in content else content[other] for k, other in keys)
        coefficients = content.get("coeffs", content.get("distortion", ()))
        shape, model = (content["width"], content["height"]), str(content.get("model", "none"))
        return intrinsics_of(shape, matrix, model, coefficients, where)


# modes of Azure Kinect by their image's size: the binned sensor's size, and where the image begins in it
_MODES = {(640, 576): (1024, 192, 180), (320, 288): (512, 96, 90), (512, 512): (512, 0, 0), (1024, 1024): (1024, 0, 0)}


def _azure_kinect(cameras: Any, size: tuple[int, ...] | None, where: str) -> Intrinsics:
    """Return the depth camera of a raw calibration for images of a size, by default those of the narrow field of view,
    unbinned. Format: Azure Kinect Sensor SDK, calibration.json."""
    depth = next(each for each in cameras if "depth" in str(each["Purpose"]).lower())
    p = [float(x) for x in depth["Intrinsics"]["ModelParameters"]]
    size = size or (640, 576)
    if size not in _MODES:
        known = ", ".join(f"{w} x {h}" for w, h in _MODES)
        raise InputError(f"{where}: images of {size[0]} x {size[1]}; expected a mode of Azure Kinect, {known}")
    binned, left, top = _MODES[size]
    matrix = (p[2] * binned, p[3] * binned, p[0] * binned - left - 0.5, p[1] * binned - top - 0.5)
    coefficients = (p[4], p[5], p[13], p[12], p[6], p[7], p[8], p[9])
    return intrinsics_of(size, matrix, "rational_polynomial", coefficients, where)


def _brown(slope: Array, c: Array, tangential_on_radial: bool) -> Array:
    """Return distorted slopes by Brown-Conrady; of the modified model the tangential part is of the radial one."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.pad(c, (0, 8 - len(c)))
    r2 = (slope**2).sum(axis=-1)
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    x, y = np.moveaxis(slope, -1, 0)
    xr, yr = x * radial, y * radial
    tx, ty = (xr, yr) if tangential_on_radial else (x, y)
    shift = np.stack([2 * p1 * tx * ty + p2 * (r2 + 2 * tx**2), 2 * p2 * tx * ty + p1 * (r2 + 2 * ty**2)], axis=-1)
    return np.asarray(np.stack([xr, yr], axis=-1) + shift)


def _inverse(distort: Any) -> Any:
    """Return the inverse of a distortion by damped fixed-point rounds."""

    def undistort(distorted: Array, c: Array) -> Array:
        slope = distorted.copy()
        for _ in range(_ROUNDS):
            with np.errstate(all="ignore"):
                off = distorted - distort(slope, c)
                slope = np.clip(np.nan_to_num(slope + off), -_MOST_SLOPE, _MOST_SLOPE)
            if np.abs(off).max() < 1e-10:
                break
        return slope

    return undistort


def _kannala_brandt(slope: Array, c: Array) -> Array:
    k = np.pad(c, (0, 4))[:4]
    r = np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-12)
    theta = np.arctan(r)
    t2 = theta**2
    return np.asarray(slope * theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) / r)


def _un_kannala_brandt(distorted: Array, c: Array) -> Array:
    k = np.pad(c, (0, 4))[:4]
    r = np.maximum(np.linalg.norm(distorted, axis=-1, keepdims=True), 1e-12)
    theta = r.copy()
    for _ in range(20):  # Newton
        t2 = theta**2
        value = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) - r
        slope = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + 9 * t2 * k[3])))
        theta = np.clip(theta - value / np.where(np.abs(slope) < 1e-6, 1.0, slope), 0.0, 1.55)
    return np.asarray(distorted * np.tan(theta) / r)


def _ftheta(slope: Array, c: Array) -> Array:
    """Return the SDK's: rd = atan(2 r tan(w / 2)) / w."""
    r = np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-12)
    return np.asarray(slope * np.arctan(2 * r * np.tan(c[0] / 2)) / (c[0] or 1.0) / r)


def _un_ftheta(distorted: Array, c: Array) -> Array:
    r = np.maximum(np.linalg.norm(distorted, axis=-1, keepdims=True), 1e-12)
    return np.asarray(distorted * np.tan(np.clip(c[0] * r, -1.55, 1.55)) / (2 * np.tan(c[0] / 2) or 1.0) / r)


_Lens = Callable[[Array, Array], Array]
_plain, _modified = partial(_brown, tangential_on_radial=False), partial(_brown, tangential_on_radial=True)
_LENSES: Mapping[str, tuple[_Lens, _Lens]] = {  # from slopes to distorted ones, and back
    "brown_conrady": (_plain, _inverse(_plain)),
    "inverse_brown_conrady": (_modified, _inverse(_modified)),
    "modified_brown_conrady": (_modified, _inverse(_modified)),
    "kannala_brandt4": (_kannala_brandt, _un_kannala_brandt),
    "ftheta": (_ftheta, _un_ftheta),
}
