"""Results as JSON, written in one way. Their values are in the border's units, mm and kPa, by `fabdesign/units.py`; a
name says the unit (`objective_mm`), or the docstring of the `as_json` that made it."""

import json
from dataclasses import fields, is_dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from fabdesign.output import write_text


def json_text(content: Any, *, indent: int | None = None) -> str:
    """JSON of plain values, dataclasses, arrays and paths; what is not finite becomes null, for JSON knows no other."""
    return json.dumps(_plain(content), indent=indent, allow_nan=False)


def write_json(path: Path, content: Any) -> None:
    """Write `content` to `path`, whole or not at all."""
    write_text(path, json_text(content, indent=1) + "\n")


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if hasattr(value, "tolist"):  # of numpy, which is not loaded for a help
        return _plain(value.tolist())
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not isfinite(value) else value
