"""Strict STL, ascii and binary: what is short, long or odd is refused, never guessed.

Format: 3D Systems, StereoLithography Interface Specification (1989).
"""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.bounded_file import read_bytes
from fabdesign.errors import InputError

_START = 84  # bytes of a binary file's header and count
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# a facet of an ascii file, word by word; None: a number
_VERTEX = ("vertex", None, None, None)
_WORDS = ("facet", "normal", None, None, None, "outer", "loop", *_VERTEX * 3, "endloop", "endfacet")
_NAME_LINES = re.compile(rb"^[ \t]*(end)?solid\b[^\r\n]*", re.MULTILINE | re.IGNORECASE)


def read_stl(path: Path | str) -> NDArray[np.float64]:
    """(t, 3, 3) corners of the triangles, in the file's unit. Raises InputError, with one line, for anything that is
    not exactly a sound file."""
    path = Path(path)
    content = read_bytes(path, "an STL mesh")
    count = int.from_bytes(content[80:_START], "little")
    size = _START + count * _FACET.itemsize
    if len(content) >= _START and len(content) == size:
        facets = np.frombuffer(content, _FACET, count, _START)
        return facets["corners"].astype(np.float64)
    if content[:5].lower() == b"solid":
        return _ascii(content, path)
    short = len(content) < _START
    raise _bad(
        path, f"has {len(content)} bytes; " + ("a header has 84" if short else f"its {count} facets need {size}")
    )


def _ascii(content: bytes, path: Path) -> NDArray[np.float64]:
    names = [bool(match.group(1)) for match in _NAME_LINES.finditer(content)]
    if names[::2] != [False] * (len(names) // 2) or names[1::2] != [True] * (len(names) // 2):
        raise _bad(path, "is cut short: a solid has no end" if names[-1:] == [False] else "its solids do not pair")
    words = _NAME_LINES.sub(b"", content).split()
    facets, rest = divmod(len(words), len(_WORDS))
    grid = np.array(words[: facets * len(_WORDS)], dtype="S24").reshape(facets, len(_WORDS))
    numbers = [i for i, word in enumerate(_WORDS) if word is None]
    odd = np.zeros(facets, dtype=bool)
    for i, word in enumerate(_WORDS):
        if word is not None:
            odd |= np.char.lower(grid[:, i]) != word.encode()
    try:
        values = grid[:, numbers].astype(np.float64) if not odd.any() else np.zeros((facets, 0))
    except ValueError:
        raise _bad(path, "a facet has a word where a number should be") from None
    if odd.any() or rest:
        raise _bad(path, f"facet {int(odd.argmax()) if odd.any() else facets} is not whole")
    return values[:, 3:].reshape(-1, 3, 3)


def _bad(path: Path, why: str) -> InputError:
    return InputError(f"{path}: {why}; expected a sound STL")
