"""Values as JSON, written and read in one way.

Results stand there in the border's units, mm and kPa: the fields of a dataclass declare key and unit where they differ
(`Key` and `FileUnit` of `schema`), as in any other file. A class whose keys are not its fields has them in `json_keys`:

    json_keys: ClassVar = (
        "complete",  # a field or property
        "study.seed",  # the key is its last name; of None all is None
        ("by_time.error_mm", "errors.rms"),  # a key, in a table; one that ends in _mm or _kpa has that unit
        ("cycles", lambda of: len(of.pressures)),  # what is computed of the object; with the key "**" a table's keys
    )

What is kept between runs stands there `exact`, to the last bit: SI, by the fields' own names, arrays as their bytes.
Nothing but what a declared type says is made of it again, so that a file of others can do no harm.
"""

import base64
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache, partial
from math import isfinite
from pathlib import Path
from types import NoneType
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

from fabdesign.errors import InputError
from fabdesign.formats.schema import MM, FileKey, FileUnit, Key, Notes, annotated, file_key, members, unit_of
from fabdesign.output import write_text
from fabdesign.units import in_kpa

T = TypeVar("T")


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


def plain(value: Any, unit: FileUnit | None = None) -> Any:
    """Return what JSON holds of a value: of a dataclass a table. unit: of numbers that declare none."""
    if is_dataclass(value) and not isinstance(value, type):
        return _table(value, unit)
    if hasattr(value, "tolist"):  # of numpy, which is not loaded for a help
        return plain(value.tolist(), unit)
    if isinstance(value, Mapping | list | tuple):
        return _each(partial(plain, unit=unit), value)
    if isinstance(value, Path):
        return str(value)
    if not isinstance(value, float):
        return value
    return (float(unit.write(value)) if unit else value) if isfinite(value) else None


def _table(value: Any, unit: FileUnit | None) -> dict[str, Any]:
    """Return the table of a dataclass. unit: of the numbers that declare none."""
    table: dict[str, Any] = {}
    for each, source in _keys(cast(Any, type(value))):
        item, key = source(value), each.notes.key
        if not each.name or (key.brief and item == each.default):
            continue
        inner = table
        for name in each.tables:
            inner = inner.setdefault(name, {})
        content = plain(item, unit_of(each.notes) or unit)
        inner |= (content or {}) if key.inside else {each.name: content}
    return table


_UNITS = {"_mm": MM, "_kpa": FileUnit("kPa", write=in_kpa)}  # by the ending of a key


@cache
def _keys(form: type) -> tuple[tuple[FileKey, Callable[[Any], Any]], ...]:
    """Return the keys of a dataclass, each with what takes its value from the object."""
    declared = {field.name: field for field in fields(form)}
    keys = []
    for entry in getattr(form, "json_keys", declared):
        name, source = entry if isinstance(entry, tuple) else (entry.rpartition(".")[2], entry)
        if name == source and name in declared:
            key = file_key(name, declared[name].type, declared[name])
        else:
            *tables, name = name.split(".")
            unit = next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), None)
            key = FileKey(name, tuple(tables), name, Notes(Any, Key(inside=name == "**"), unit))
        keys.append((key, source if callable(source) else partial(_at, source.split("."))))
    return tuple(keys)


def _at(path: Sequence[str], value: Any) -> Any:
    """Return what stands at the end of a path of attributes, or of a mapping's keys; None behind a None."""
    for name in path:
        if value is None:
            break
        value = value[name] if isinstance(value, Mapping) else getattr(value, name)
    return value


def exact(value: Any) -> Any:
    """Return what JSON holds of a value from which `of_exact` makes the same value."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: exact(getattr(value, field.name)) for field in fields(value)}
    if hasattr(value, "tolist"):
        if value.ndim:
            data = base64.b64encode(value.tobytes()).decode()
            return {"dtype": value.dtype.str, "shape": list(value.shape), "data": data}
        return exact(value.tolist())
    if isinstance(value, Mapping | list | tuple):
        return _each(exact, value)
    return str(value) if isinstance(value, Path) else value


def _each(convert: Callable[[Any], Any], value: Any) -> Any:
    """Return a table or list of what its items are converted to."""
    if isinstance(value, Mapping):
        return {key: convert(item) for key, item in value.items()}
    return [convert(item) for item in value]


def of_exact(kind: type[T], value: Any) -> T:
    """Return the value of that type that `exact` was given. Raises KeyError, TypeError or ValueError for anything
    else."""
    return cast(T, _of(kind, value))


def _of(kind: Any, value: Any) -> Any:
    import numpy as np

    kind = annotated(kind).type
    origin, inner, alternatives = get_origin(kind), get_args(kind), members(kind)
    if alternatives != (kind,):
        if value is None and NoneType in inner:
            return None
        [kind] = alternatives
        return _of(kind, value)
    if origin is np.ndarray:
        dtype = np.dtype(value["dtype"])
        if dtype.hasobject:
            raise ValueError(f"an array of {dtype}")
        return np.frombuffer(base64.b64decode(value["data"]), dtype).reshape(value["shape"]).copy()
    if origin is tuple:
        each = [inner[0]] * len(value) if inner[-1] is Ellipsis else inner
        return tuple(_of(one, entry) for one, entry in zip(each, value, strict=True))
    if origin is not None and issubclass(origin, Mapping):
        return {name: _of(inner[1], entry) for name, entry in value.items()}
    if origin is not None and issubclass(origin, list):
        return [_of(inner[0], entry) for entry in value]
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        return cast(Any, kind)(**{name: _of(hints[name], entry) for name, entry in value.items()})
    if kind is not Any and not isinstance(value, kind) and not (kind is float and isinstance(value, int)):
        raise TypeError(f"{value!r} is no {kind.__name__}")
    return value
