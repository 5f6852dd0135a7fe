"""TOML and other texts as files: few enough bytes, and nothing that would cost the parser minutes."""

import re
import tomllib
from decimal import Decimal
from hashlib import sha256
from pathlib import Path
from typing import Any

from fabdesign.errors import CONTROL, InputError
from fabdesign.formats.bounded_file import decode, read_bytes

LARGEST_TEXT = 50_000_000  # bytes: a table of some million rows
LARGEST_TOML = 2_000_000
_LONGEST_NAME = 255  # bytes of a name on usual file systems
_LONGEST_STEM = 120  # bytes, which leaves room for endings
_NO_FILE = re.compile(r"\A\.+|[/\\\x00-\x1f\x7f]")
_LONGEST_LINE = 500_000  # characters: the times of some ten thousand frames
_DEEPEST = 32  # parts of a key such as a.b.c, whose time tomllib squares
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DEEP_KEY = re.compile(rf"(?<![\w-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{_DEEPEST},}}+[ \t]*+([=\]]?)")


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


def read_text(path: Path, *, largest: int = LARGEST_TEXT) -> str:
    """Return a plain text file's content, of at most `largest` bytes; InputError where it cannot be read."""
    return decode(read_bytes(path, "a text file", largest=largest), path)
