"""The arrays of an npz or npy; whatever is wrong with the file becomes one line."""

import io
import math
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.bounded_file import read_bytes
from fabdesign.errors import InputError

# what numpy and zipfile raise for damaged bytes
_DAMAGED = (
    OSError, ValueError, EOFError, KeyError, TypeError, AttributeError, RuntimeError, zipfile.BadZipFile, zlib.error,
    MemoryError, OverflowError, SyntaxError, NotImplementedError,
)  # fmt: skip
_NPY = b"\x93NUMPY"
LARGEST = 600_000_000  # bytes of all arrays: what they grow to on the way still has room


class NpzArrays:
    """The arrays of an open npz, read as they are asked for."""

    def __init__(self, archive: np.lib.npyio.NpzFile, path: Path) -> None:
        self._archive = archive
        self._path = path

    def __contains__(self, name: str) -> bool:
        return name in self._archive.files

    def get(self, name: str) -> NDArray[Any]:
        """Raises InputError where it is not there."""
        if name not in self:
            raise InputError(f"{self._path}: no array {name}; it has {', '.join(self._archive.files) or 'none'}")
        return np.asarray(self._archive[name])


@contextmanager
def open_npz(path: Path, expected: str) -> Iterator[NpzArrays]:
    """Raises InputError, which names what was `expected`, for no file, another one, and damage met inside the block."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is no plain file; expected an npz with {expected}")
        with path.open("rb") as stream:
            if stream.read(len(_NPY)) == _NPY:
                raise InputError(f"{path}: holds one array; expected an npz with {expected}")
            stream.seek(0)
            archive = np.load(stream, allow_pickle=False)
            _require_small(archive, path, expected)
            yield NpzArrays(archive, path)
    except InputError:  # a ValueError, of this block's own
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except _DAMAGED:
        raise InputError(f"{path}: is damaged or cut short; expected an npz with {expected}") from None


def read_npy(path: Path) -> NDArray[np.float64]:
    """(n, 3) points of an npy, also of an image (rows, columns, 3). Raises InputError for damage, another shape and
    what is no number."""
    expected = "an npy with points (n, 3)"
    content = read_bytes(path, expected)
    stream = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(stream)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = header(stream)
    except _DAMAGED:
        raise InputError(f"{path}: is damaged or no npy; expected {expected}") from None
    if dtype.kind not in "fiu" or len(shape) not in (2, 3) or shape[-1] != 3:
        raise InputError(f"{path}: is {shape} {dtype}; expected {expected}")
    size = math.prod(shape) * dtype.itemsize  # before an array is made that has only its header's word
    if len(content) - stream.tell() != size:
        raise InputError(
            f"{path}: has {len(content) - stream.tell()} bytes of points and not {size}; expected {expected}"
        )
    return np.load(io.BytesIO(content), allow_pickle=False).astype(np.float64).reshape(-1, 3)


def _require_small(archive: np.lib.npyio.NpzFile, path: Path, expected: str) -> None:
    """By what the archive says of itself: nothing is read beyond it, and what an array's header claims is not there."""
    assert archive.zip is not None
    size = sum(member.file_size for member in archive.zip.infolist())
    if size > LARGEST:
        raise InputError(
            f"{path}: unpacks to {size / 1e6:.0f} MB; expected an npz with {expected} of at most {LARGEST / 1e6:.0f} MB"
        )
