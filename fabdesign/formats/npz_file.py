"""The arrays of an npz or npy; whatever is wrong with the file becomes one line.

What an array takes in memory is counted by its header, before it is made.
"""

import io
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from fabdesign.errors import InputError
from fabdesign.formats.toml_file import open_plain, parsing, read_bytes, require_count

_NPY = b"\x93NUMPY"
LARGEST = 600_000_000  # bytes of all arrays as they lie in the file, unpacked
IN_MEMORY = 1_200_000_000  # bytes of one array as it lies in the file and as the float64 that it becomes, together


class NpzArrays:
    """The arrays of an open npz, read as they are asked for."""

    def __init__(self, archive: np.lib.npyio.NpzFile, path: Path, damaged: tuple[str, str]) -> None:
        self._archive, self._path, self._damaged = archive, path, damaged

    def __contains__(self, name: str) -> bool:
        return name in self._archive.files

    @property
    def names(self) -> list[str]:
        return self._archive.files

    def shape(self, name: str) -> tuple[int, ...]:
        """Return an array's shape without reading it. Raises InputError where it is not there."""
        return self._declared(name)[0]

    def get(self, name: str, becomes: DTypeLike = np.float64) -> NDArray[Any]:
        """Return an array; `becomes` is the type that its numbers are taken to next. Raises InputError where it is not
        there, damaged, or too large."""
        shape, dtype = self._declared(name)
        after = np.dtype(becomes).itemsize if dtype.kind in "fiu" and dtype != becomes else 0
        size = math.prod(shape) * (dtype.itemsize + after)
        if size > IN_MEMORY:
            raise InputError(
                f"{self._path}: {name}, {shape} {dtype}, takes {size / 1e6:.0f} MB in memory; expected at most "
                f"{IN_MEMORY / 1e6:.0f} MB"
            )
        with parsing(self._path, *self._damaged):
            return np.asarray(self._archive[name])

    def sound(
        self, name: str, expected: str, fits: Callable[[NDArray[Any]], object], kinds: str = "fiu", **how: Any
    ) -> NDArray[Any]:
        """Return an array of numbers, of those `kinds` of numpy's, that fits. Raises InputError, which says shape and
        type, for another one, and like `get`, which takes `how`."""
        array = self.get(name, **how)
        if array.dtype.kind not in kinds or not fits(array):
            raise InputError(f"{self._path}: {name} is {array.shape} {array.dtype}; expected {expected}")
        return array

    def _declared(self, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
        if name not in self:
            raise InputError(f"{self._path}: no array {name}; it has {', '.join(self._archive.files) or 'none'}")
        assert self._archive.zip is not None
        member = next(n for n in self._archive.zip.namelist() if n in (name, f"{name}.npy"))
        with parsing(self._path, *self._damaged), self._archive.zip.open(member) as stream:
            shape, dtype = _header(stream)
            size = stream.tell() + math.prod(shape) * dtype.itemsize
            if dtype.hasobject or size != self._archive.zip.getinfo(member).file_size:
                raise ValueError(size)
        return shape, dtype


@contextmanager
def open_npz(path: Path, expected: str) -> Iterator[NpzArrays]:
    """Open an npz. Raises InputError, which names what was `expected`, for no file, another one, and damage met inside
    the block."""
    damaged = "is damaged or cut short", f"an npz with {expected}"
    with open_plain(path, damaged[1]) as stream:
        if stream.read(len(_NPY)) == _NPY:
            raise InputError(f"{path}: holds one array; expected an npz with {expected}")
        stream.seek(0)
        with parsing(path, *damaged):
            archive = np.load(stream, allow_pickle=False)
        if repeated := next((name for name in archive.files if archive.files.count(name) > 1), None):
            raise InputError(f"{path}: has the array {repeated} twice; expected each once")
        assert archive.zip is not None
        size = sum(member.file_size for member in archive.zip.infolist())
        if size > LARGEST:  # nothing is read beyond that, and what an array's header claims is not there
            most = f"{LARGEST / 1e6:.0f} MB"
            raise InputError(
                f"{path}: unpacks to {size / 1e6:.0f} MB; expected an npz with {expected} of at most {most}"
            )
        yield NpzArrays(archive, path, damaged)


def read_npy(path: Path) -> NDArray[Any]:
    """Return the points (n, 3) of an npy, or its image (rows, columns, 3). Raises InputError for damage, another shape
    and what is no number."""
    expected = "an npy with points (n, 3)"
    content = read_bytes(path, expected)
    stream = io.BytesIO(content)
    with parsing(path, "is damaged or no npy", expected):
        shape, dtype = _header(stream)
    if dtype.kind not in "fiu" or len(shape) not in (2, 3) or shape[-1] != 3:
        raise InputError(f"{path}: is {shape} {dtype}; expected {expected}")
    size = math.prod(shape) * dtype.itemsize  # before an array is made that has only its header's word
    if len(content) - stream.tell() != size:
        raise InputError(
            f"{path}: has {len(content) - stream.tell()} bytes of points and not {size}; expected {expected}"
        )
    require_count(math.prod(shape) // 3, path, "points")
    stream.seek(0)
    return np.asarray(np.load(stream, allow_pickle=False))


def _header(stream: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return the shape and type of an npy. Raises whatever numpy does."""
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    if not all(isinstance(n, int) and n >= 0 for n in shape):
        raise ValueError(shape)
    return shape, dtype
