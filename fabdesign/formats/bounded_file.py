"""A file's bytes, where they are few enough to be what was asked for."""

import re
from pathlib import Path

from fabdesign.errors import InputError, note

LARGEST = 100_000_000  # bytes of a cloud or mesh: some million points, read in seconds
MOST_POINTS = 10_000_000  # of one cloud, vertices or faces of a mesh: 240 MB as float64, more while they are checked
_OF_NO_TEXT = re.compile("[\x00-\x08\x0e-\x1f\x7f]")


def read_bytes(path: Path, what: str, *, largest: int = LARGEST) -> bytes:
    """Return the whole content; `what` it should be goes into the messages. Raises InputError for a file that is not
    there, not plain (a device, a pipe), larger than `largest` bytes, or cannot be read."""
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


def require_few(count: int, path: Path, what: str) -> None:
    """Raise InputError for more points or faces than a cloud or mesh may have, before there is an array of them."""
    if count > MOST_POINTS:
        raise InputError(f"{path}: has {count} {what}; expected at most {MOST_POINTS}")


def decode_any(content: bytes, path: Path) -> str:
    """Return the text of a laboratory's program: UTF-8, UTF-16 with its mark, else the code page of western Europe,
    which is said. Raises InputError for what has characters of no text."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    else:
        try:
            return content.decode("utf-8-sig")
        except UnicodeDecodeError:
            encoding = "cp1252"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        text = "\0"
    if _OF_NO_TEXT.search(text):
        raise InputError(f"{path}: is not a text file")
    note(f"{path}: read as {encoding} text")
    return text


def decode(content: bytes, path: Path) -> str:
    """Return the UTF-8 text. Raises InputError for any other."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file (UTF-8)") from None
