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
    values = _pixels(content, where, _DEPTH_MODES, "16 bits, one channel (is it colour?)", None)
    if values.dtype != np.uint16 and values.size and not 0 <= values.min() <= values.max() < 2**16:
        raise InputError(f"{where}: depths from {values.min()} to {values.max()}; expected 16 bits")
    return np.asarray(values.astype(np.uint16))


def colour_image(content: bytes, where: str) -> NDArray[np.uint8]:
    """Return (rows, columns, 3) of a PNG, TIFF or JPEG with 8 bits a channel. Raises InputError."""
    return _pixels(content, where, _COLOUR_MODES, "red, green and blue of 8 bits", "RGB")


def _pixels(content: bytes, where: str, modes: tuple[str, ...], expected: str, mode: str | None) -> NDArray[Any]:
    """Return an image's pixels, converted to a mode of PIL. Raises InputError."""
    from PIL import Image

    try:
        opened: Any = Image.open(io.BytesIO(content), formats=("PNG", "TIFF", "JPEG"))
        with opened as image:
            width, height = image.size
            if width * height > MOST_PIXELS:
                most = f"{MOST_PIXELS / 1e6:.1f} million"
                raise InputError(f"{where}: {width} x {height} pixels; expected at most {most}")
            if getattr(image, "n_frames", 1) != 1:
                raise InputError(f"{where}: holds {image.n_frames} images; expected one")
            if image.mode not in modes:
                raise InputError(f"{where}: an image of kind {image.mode}; expected {expected}")
            return np.asarray(image if mode is None else image.convert(mode))
    except InputError:
        raise
    except Exception as error:  # PIL raises whatever its parsers meet
        line = f"{where}: cannot be read as an image ({type(error).__name__}); expected a whole PNG or TIFF"
        raise InputError(line) from None
