"""Results as JSON, written and read in one way. Their values are in the border's units, mm and kPa: a field of a
dataclass declares its unit and its key in the file where they differ (`Annotated` with `fabdesign.units.InFile`)."""

import json
from collections.abc import Mapping
from dataclasses import Field, fields, is_dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from fabdesign.errors import InputError
from fabdesign.output import write_text
from fabdesign.units import InFile


def json_text(content: Any, *, indent: int | None = None) -> str:
    """Return JSON of plain values, dataclasses, arrays and paths; what is not finite becomes null, for JSON knows no
    other."""
    return json.dumps(plain(content), indent=indent, allow_nan=False)


def write_json(path: Path, content: Any) -> None:
    """Write `content` to `path`, whole or not at all."""
    write_text(path, json_text(content, indent=1) + "\n")


def read_json(path: Path, kind: type = dict) -> Any:
    """Return what a file holds, of that type. Raises InputError, which says where it is damaged."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    if not isinstance(content, kind):
        raise InputError(f"{path}: expected a {'table' if kind is dict else kind.__name__} at the top")
    return content


def plain(value: Any) -> Any:
    """Return what a file holds of a value: of a dataclass a table of its fields, as they declare it."""
    if is_dataclass(value) and not isinstance(value, type):
        return dict(_entry(field, getattr(value, field.name)) for field in fields(value))
    if hasattr(value, "tolist"):  # of numpy, which is not loaded for a help
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not isfinite(value) else value


def _entry(field: "Field[Any]", value: Any) -> tuple[str, Any]:
    declared = [one for one in getattr(field.type, "__metadata__", ()) if isinstance(one, InFile)]
    shown = declared[0] if declared else InFile()
    return shown.key or field.name, plain(value if shown.factor == 1.0 else shown.factor * value)
