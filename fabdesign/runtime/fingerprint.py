"""The content that kept work depends on, by field: hashes of files, designs, options, the version of the algorithm,
which its author raises. Work goes on only where all of it is the same."""

import hashlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError

_SHOWN = 3  # fields that differ
_LONGEST_SHOWN = 50  # characters of a value in a message
_LONGEST = 200  # characters that are kept of a value; of longer ones their hash


class OtherContent(InputError):
    """An error: what is kept is of other content than the work that is to go on."""


def sha256(*parts: Path | str | NDArray[Any]) -> str:
    """Return the hash of files' bytes, of texts in UTF-8 and of arrays' bytes, one after another."""
    content = hashlib.sha256()
    for part in parts:
        content.update(
            part.encode() if isinstance(part, str) else part.read_bytes() if isinstance(part, Path) else part.tobytes()
        )
    return content.hexdigest()


def content_of(study: Any, but: Collection[str], more: Mapping[str, Any]) -> dict[str, str]:
    """Return the fields of a dataclass as text, down to what is no dataclass, but for those of some names; then `more`,
    which may take the place of one. Of long values their hash."""
    content: dict[str, Any] = {}
    for field in fields(study):
        if field.name not in but:
            content |= _flat(getattr(study, field.name), field.name)
    texts = {name: str(value) for name, value in {**content, **more}.items()}
    return {name: text if len(text) <= _LONGEST else f"sha256 {sha256(text)}" for name, text in texts.items()}


def _flat(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield a value's parts by field, down to what is no dataclass."""
    if is_dataclass(value):
        for field in fields(value):
            yield from _flat(getattr(value, field.name), f"{name}.{field.name}")
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            yield from _flat(entry, f"{name}.{key}")
    elif isinstance(value, tuple) and any(map(is_dataclass, value)):
        for number, entry in enumerate(value, start=1):
            yield from _flat(entry, f"{name} {number}")
    else:
        yield name, value.tolist() if isinstance(value, np.ndarray) else value


def require_same(known: Mapping[str, str], content: Mapping[str, str], folder: Path, holds: str) -> None:
    """Raise OtherContent, which says what differs, where what is kept is of other content. holds: what it then is."""
    differing = [name for name in {**known, **content} if known.get(name) != content.get(name)]
    if not differing:
        return
    clauses = []
    for name in differing[:_SHOWN]:
        before, now = known.get(name, "not there"), content.get(name, "not there")
        long = max(len(before), len(now)) > _LONGEST_SHOWN
        clauses.append(f"{name} differs" if long else f"{name} was {before}, now {now}")
    if more := len(differing) - len(clauses):
        clauses.append(f"and {more} more")
    raise OtherContent(
        f"{folder}: holds {holds} ({'; '.join(clauses)}); expected the same one, or --force to start anew"
    )
