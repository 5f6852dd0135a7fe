"""Files' bytes, texts and TOML: few enough bytes to be what was asked for, and nothing that would cost a parser
minutes."""

import os
import re
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal
from hashlib import sha256
from pathlib import Path
from typing import Any, BinaryIO

from fabdesign.errors import CONTROL, InputError, note

LARGEST = 100_000_000  # bytes of a cloud or mesh: some million points, read in seconds
MOST_POINTS = 10_000_000  # of one cloud, vertices or faces of a mesh: 240 MB as float64, more while they are checked
_OF_NO_TEXT = re.compile("[\x00-\x08\x0e-\x1f\x7f]")
LARGEST_TEXT = 50_000_000  # bytes: a table of some million rows
LARGEST_TOML = 2_000_000
_LONGEST_NAME = 255  # bytes of a name on usual file systems
_LONGEST_STEM = 120  # bytes, which leaves room for endings
_NO_FILE = re.compile(r"\A\.+|[/\\\x00-\x1f\x7f]")
_LONGEST_LINE = 500_000  # characters: the times of some ten thousand frames
_DEEPEST = 32  # parts of a key such as a.b.c, whose time tomllib squares
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DEEP_KEY = re.compile(rf"(?<![\w-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{_DEEPEST},}}+[ \t]*+([=\]]?)")


@contextmanager
def open_plain(path: Path, what: str) -> Iterator[BinaryIO]:
    """Open a file; `what` it should be goes into the messages. Raises InputError for one that is not there, not plain
    (a device, a pipe), or cannot be read."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is no plain file; expected {what}")
        with path.open("rb") as stream:
            yield stream
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


@contextmanager
def parsing(where: Path | str, why: str, expected: str = "") -> Iterator[None]:
    """Raise InputError for whatever a parser raises within the block. why: has {} where the kind of error is said."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        line = f"{where}: {why.format(type(error).__name__)}"
        raise InputError(f"{line}; expected {expected}" if expected else line) from None


def read_bytes(path: Path, what: str, *, largest: int = LARGEST) -> bytes:
    """Return the whole content. Raises InputError like `open_plain`, and for more than `largest` bytes."""
    with open_plain(path, what) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size <= largest:
            content = stream.read(largest + 1)
            size = len(content)
    if size > largest:
        raise InputError(f"{path}: has {size / 1e6:.0f} MB; expected {what} of at most {largest / 1e6:.0f} MB")
    return content


def require_count(count: int, path: Path, what: str) -> None:
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


def parse_toml(path: Path) -> dict[str, Any]:
    """Return the file as plain values, floats as Decimal; InputError where it is not TOML."""
    text = read_text(path, largest=LARGEST_TOML)
    if deep := next((match for match in _DEEP_KEY.finditer(text) if match[1]), None):  # else words of a text
        line = text.count("\n", 0, deep.start()) + 1
        raise InputError(f"{path} line {line}: {deep[0][:20]}... has over {_DEEPEST} parts; expected a shorter key")
    if (longest := max(map(len, text.splitlines()), default=0)) > _LONGEST_LINE:
        raise InputError(f"{path}: has a line of {longest} characters; expected at most {_LONGEST_LINE}")
    try:
        content = tomllib.loads(text, parse_float=Decimal)
    except (ValueError, ArithmeticError) as error:  # of the grammar, or numbers of thousands of digits
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is not sound TOML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise InputError(f"{path}: is not sound TOML: nested too deep") from None
    _require_no_control(content, path)
    return content


def _require_no_control(content: dict[str, Any], path: Path) -> None:
    """Raise InputError for a text that would command a terminal, or break the lines of what it is written to."""
    remaining: list[Any] = [content]
    while remaining:
        value = remaining.pop()
        if isinstance(value, dict):
            if bad := next((key for key in value if CONTROL.search(key) or "\n" in key or "\t" in key), None):
                raise InputError(f"{path}: the key {bad[:40]!a} has control characters; expected none")
            remaining += value.values()
        elif isinstance(value, list):
            remaining += value
        elif isinstance(value, str) and CONTROL.search(value):
            raise InputError(f"{path}: the text {value[:40]!a} has control characters; expected none")


def file_name(text: str, where: str) -> str:
    """Return the text, where it can be the name of a file; InputError otherwise."""
    if "\0" in text or any(len(part.encode("utf-8", "surrogateescape")) > _LONGEST_NAME for part in Path(text).parts):
        raise InputError(f"{where}: {text[:57]!r}; expected the name of a file")
    return text


def file_stem(name: str) -> str:
    """Return a name from a file as the name of one file or folder: itself where it can be one, else without what leads
    to another folder, and told apart from similar names."""
    plain = _NO_FILE.sub("_", name).encode("utf-8", "surrogateescape")[:_LONGEST_STEM].decode("utf-8", "ignore")
    if plain == name and name:
        return name
    return f"{plain}_{sha256(name.encode('utf-8', 'surrogateescape')).hexdigest()[:6]}"


def read_text(path: Path, what: str = "a text file", *, largest: int = LARGEST_TEXT) -> str:
    """Return the content of a plain UTF-8 file of at most `largest` bytes; InputError, which says `what` was expected,
    where it cannot be read."""
    try:
        return read_bytes(path, what, largest=largest).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file (UTF-8)") from None
