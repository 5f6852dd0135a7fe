"""Images of depth and colour from PNG and TIFF bytes: the size is checked before a pixel is unpacked."""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.depth.intrinsics import MOST_PIXELS
from fabdesign.errors import InputError

_DEPTH_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I")
_COLOUR_MODES = ("RGB", "L", "RGBA", "P")


def depth_image(content: bytes, where: str) -> NDArray[np.uint16]:
    """Return (rows, columns) of a 16-bit PNG or TIFF. Raises InputError."""
    image = _opened(content, where)
    with image:
        if image.mode not in _DEPTH_MODES:
            raise InputError(f"{where}: an image of kind {image.mode}; expected 16 bits, one channel (is it colour?)")
        values = _pixels(image, where)
    if values.dtype != np.uint16 and values.size and not 0 <= values.min() <= values.max() < 2**16:
        raise InputError(f"{where}: depths from {values.min()} to {values.max()}; expected 16 bits")
    return np.asarray(values.astype(np.uint16))


def colour_image(content: bytes, where: str) -> NDArray[np.uint8]:
    """Return (rows, columns, 3) of a PNG, TIFF or JPEG with 8 bits a channel. Raises InputError."""
    image = _opened(content, where)
    with image:
        if image.mode not in _COLOUR_MODES:
            raise InputError(f"{where}: an image of kind {image.mode}; expected red, green and blue of 8 bits")
        _require_size(image, where)
        try:
            return np.asarray(image.convert("RGB"), dtype=np.uint8)
        except Exception as error:
            raise _damaged(where, error) from None


def _opened(content: bytes, where: str) -> Any:
    from PIL import Image

    try:
        image = Image.open(io.BytesIO(content), formats=("PNG", "TIFF", "JPEG"))
    except Exception as error:  # it raises whatever its parsers meet
        raise _damaged(where, error) from None
    _require_size(image, where)
    return image


def _require_size(image: Any, where: str) -> None:
    width, height = image.size
    if width * height > MOST_PIXELS:
        raise InputError(f"{where}: {width} x {height} pixels; expected at most {MOST_PIXELS / 1e6:.1f} million")
    if getattr(image, "n_frames", 1) != 1:
        raise InputError(f"{where}: holds {image.n_frames} images; expected one")


def _pixels(image: Any, where: str) -> NDArray[Any]:
    try:
        return np.asarray(image)
    except Exception as error:
        raise _damaged(where, error) from None


def _damaged(where: str, error: Exception) -> InputError:
    return InputError(f"{where}: cannot be read as an image ({type(error).__name__}); expected a whole PNG or TIFF")
