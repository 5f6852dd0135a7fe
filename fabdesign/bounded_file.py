"""A file's bytes, where they are few enough to be what was asked for."""

from pathlib import Path

from fabdesign.errors import InputError

LARGEST = 100_000_000  # bytes of a cloud or mesh: some million points, read in seconds


def read_bytes(path: Path, what: str, *, largest: int = LARGEST) -> bytes:
    """The whole content; `what` it should be goes into the messages. Raises InputError for a file that is not there,
    not plain (a device, a pipe), larger than `largest` bytes, or cannot be read."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is no plain file; expected {what}")
        size = path.stat().st_size
        if size <= largest:
            with path.open("rb") as stream:
                content = stream.read(largest + 1)
            size = len(content)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if size > largest:
        raise InputError(f"{path}: has {size / 1e6:.0f} MB; expected {what} of at most {largest / 1e6:.0f} MB")
    return content


def decode(content: bytes, path: Path) -> str:
    """As UTF-8 text; InputError otherwise."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file (UTF-8)") from None
