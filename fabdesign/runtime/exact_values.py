"""Values of declared types as JSON and back, to the last bit: frozen dataclasses, arrays, tuples, mappings, numbers.

Nothing but what the type declares is made of what is read, so that a file of others can do no harm.
"""

import base64
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

T = TypeVar("T")


def as_json(value: Any) -> Any:
    """Return what JSON holds; arrays as their bytes."""
    if isinstance(value, np.ndarray):
        whole = np.ascontiguousarray(value)
        data = base64.b64encode(whole.tobytes()).decode()
        return {"dtype": whole.dtype.str, "shape": list(value.shape), "data": data}
    if is_dataclass(value):
        return {field.name: as_json(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {name: as_json(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(one) for one in value]
    return value.item() if isinstance(value, np.generic) else value


def of_json(kind: type[T], value: Any) -> T:
    """Return the value of that type that `as_json` gave. Raises KeyError, TypeError or ValueError for anything else."""
    return cast(T, _of(kind, value))


def _of(kind: Any, value: Any) -> Any:
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        if value is None and NoneType in inner:
            return None
        [kind] = [one for one in inner if one is not NoneType]
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
    if kind is Any:
        return value
    if not isinstance(value, kind) and not (kind is float and isinstance(value, int)):
        raise TypeError(f"{value!r} is no {kind.__name__}")
    return value
