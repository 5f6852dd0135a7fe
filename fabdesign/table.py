"""Strict reading of TOML: every key is asked for, and what was not asked for is an error."""

from collections.abc import Mapping, Sequence
from decimal import Decimal
from difflib import get_close_matches
from math import isfinite
from pathlib import Path
from typing import Any, Literal, TypeVar, overload

from fabdesign.errors import InputError
from fabdesign.toml_file import file_name, parse_toml
from fabdesign.units import pascals

_REQUIRED: Any = object()
Default = TypeVar("Default")
Choice = TypeVar("Choice", bound=str)


class Table:
    """One TOML table and where it stands. Each getter notes its key as known; `finish` refuses the others.

    A key without a default must be there. All getters raise InputError.
    """

    def __init__(
        self, values: Mapping[str, Any], where: str, file: Path = Path(), outer: "Table | None" = None
    ) -> None:
        self.where = where
        self.file = file  # that it stands in: names of files are relative to its folder
        self.decoded: dict[str, Any] = {}  # fields of the dataclass that is made of it, as far as they are read
        self.name = ""  # the key that it stands under
        self._outer = outer
        self._values = values
        self._known: set[str] = set()
        self._dotted: dict[str, Table] = {}  # tables whose keys are fields of the same dataclass

    def __getitem__(self, key: str) -> Any:
        return self._values[key]

    def has(self, key: str) -> bool:
        """Whether the key is there; from now on it is a known one."""
        self._known.add(key)
        return self._values.get(key) is not None

    def take_rest(self) -> dict[str, Any]:
        """Return what no key was asked for, which is known from now on."""
        rest = {key: value for key, value in self._values.items() if key not in self._known}
        self._known |= rest.keys()
        return rest

    def inner(self, key: str, index: int | None = None) -> "Table":
        """Return the table of a key, or of [[key]] the one of that place."""
        value = self._values[key] if index is None else self._values[key][index]
        place = key if index is None else f"{key}[{index}]"
        table = Table(value, f"{self.where}: {place}", self.file, self)
        table.name = key
        return table

    def within(self, keys: Sequence[str]) -> "Table":
        """Return the table in tables, empty where it is not there, whose keys are checked with those of this one."""
        if not keys:
            return self
        first, *rest = keys
        if first not in self._dotted:
            if self.has(first) and not isinstance(self._values[first], Mapping):
                raise self.bad(first, "a table")
            values = self._values.get(first) or {}
            self._dotted[first] = Table(values, f"{self.where}: {first}", self.file, self)
        return self._dotted[first].within(rest)

    def same(self) -> "Table":
        """Return the table for another dataclass whose fields stand in it too."""
        table = Table(self._values, self.where, self.file, self)
        table._known, table._dotted = self._known, self._dotted
        return table

    def find(self, field: str) -> Any:
        """Return what was decoded of a field here or in the tables around; None where there is none yet."""
        return self.decoded[field] if field in self.decoded else self._outer.find(field) if self._outer else None

    def error(self, text: str) -> InputError:
        """Return the error that says so of the table."""
        return InputError(f"{self.where}: {text}")

    def missing(self, key: str) -> InputError:
        """Return the error for a key that must be there, with an unknown one that may be meant."""
        similar = get_close_matches(key, self._values.keys() - self._known, n=1, cutoff=0.85)
        return self.error(f"{key} is missing" + "".join(f" (is {word} meant?)" for word in similar))

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def names(self) -> list[str]:
        """The keys, in the file's order."""
        return list(self._values)

    def take(self, key: str, default: Any = _REQUIRED) -> Any:
        """The value as TOML gives it (floats as Decimal)."""
        self._known.add(key)
        if key in self._values:
            return self._values[key]
        if default is _REQUIRED:
            raise self.missing(key)
        return default

    def bad(self, key: str, expected: str) -> InputError:
        """The error for a value that is not what was expected."""
        return InputError(f"{self.where}: {key} = {_shown(self._values.get(key))}; expected {expected}")

    @overload
    def number(
        self, key: str, *, above: float | None = ..., least: float | None = ..., most: float | None = ...
    ) -> float: ...
    @overload
    def number(
        self,
        key: str,
        default: Default,
        *,
        above: float | None = ...,
        least: float | None = ...,
        most: float | None = ...,
    ) -> float | Default: ...
    def number(
        self,
        key: str,
        default: Any = _REQUIRED,
        *,
        above: float | None = None,
        least: float | None = None,
        most: float | None = None,
    ) -> Any:
        """A finite float: > `above`, >= `least`, <= `most`. A default is returned as it is (None stays None)."""
        value = self.take(key, default)
        if key not in self._values:
            return value
        number = _number(value)
        outside = number is None or not isfinite(number)
        if number is not None and not outside:
            outside = (
                (above is not None and number <= above)
                or (least is not None and number < least)
                or (most is not None and number > most)
            )
        if outside:
            raise self.bad(key, _range("a number", above, least, most))
        return number

    @overload
    def kilopascals(self, key: str, *, above: float | None = ...) -> float: ...
    @overload
    def kilopascals(self, key: str, default: Default, *, above: float | None = ...) -> float | Default: ...
    def kilopascals(self, key: str, default: Any = _REQUIRED, *, above: float | None = None) -> Any:
        """A pressure in Pa from a value in kPa, scaled in decimal so that what was written is what is read."""
        kpa = self.number(key, default, above=above)
        return pascals(self._values[key]) if key in self._values else kpa

    @overload
    def integer(self, key: str, *, least: int | None = ..., most: int | None = ...) -> int: ...
    @overload
    def integer(
        self, key: str, default: Default, *, least: int | None = ..., most: int | None = ...
    ) -> int | Default: ...
    def integer(self, key: str, default: Any = _REQUIRED, *, least: int | None = None, most: int | None = None) -> Any:
        value = self.take(key, default)
        if key not in self._values:
            return value
        outside = isinstance(value, bool) or not isinstance(value, int)
        if outside or (least is not None and value < least) or (most is not None and value > most):
            raise self.bad(key, _range("a whole number", None, least, most))
        return value

    @overload
    def flag(self, key: str) -> bool: ...
    @overload
    def flag(self, key: str, default: Default) -> bool | Default: ...
    def flag(self, key: str, default: Any = _REQUIRED) -> Any:
        value = self.take(key, default)
        if key in self._values and not isinstance(value, bool):
            raise self.bad(key, "true or false")
        return value

    @overload
    def text(self, key: str) -> str: ...
    @overload
    def text(self, key: str, default: Default) -> str | Default: ...
    @overload
    def text(self, key: str, *, choices: Sequence[Choice]) -> Choice: ...
    @overload
    def text(self, key: str, default: Default, *, choices: Sequence[Choice]) -> Choice | Default: ...
    def text(self, key: str, default: Any = _REQUIRED, *, choices: Sequence[str] = ()) -> Any:
        value = self.take(key, default)
        if key not in self._values:
            return value
        if not isinstance(value, str):
            raise self.bad(key, "a text")
        if choices and value not in choices:
            raise self.bad(key, "one of " + ", ".join(choices) + nearest(value, choices))
        return value

    def path(self, key: str, folder: Path) -> Path:
        """A file or folder, whose name is relative to `folder`."""
        return folder / file_name(self.text(key), self.where)

    @overload
    def texts(self, key: str) -> tuple[str, ...]: ...
    @overload
    def texts(self, key: str, default: Default) -> tuple[str, ...] | Default: ...
    def texts(self, key: str, default: Any = _REQUIRED) -> Any:
        """A tuple of texts."""
        value = self.take(key, default)
        if key not in self._values:
            return value
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self.bad(key, "a list of texts")
        return tuple(value)

    @overload
    def numbers(self, key: str, default: Default, *, count: Literal[3]) -> tuple[float, float, float] | Default: ...
    @overload
    def numbers(self, key: str, *, count: int | None = ...) -> tuple[float, ...]: ...
    @overload
    def numbers(self, key: str, default: Default, *, count: int | None = ...) -> tuple[float, ...] | Default: ...
    def numbers(self, key: str, default: Any = _REQUIRED, *, count: int | None = None) -> Any:
        """A tuple of `count` finite floats (any number of them without `count`)."""
        value = self.take(key, default)
        if key not in self._values:
            return value
        parsed = _numbers(value, count)
        if parsed is None:
            raise self.bad(key, f"a list of {count} numbers" if count is not None else "a list of numbers")
        return parsed

    @overload
    def pair(self, key: str, *, above: float) -> tuple[float, float]: ...
    @overload
    def pair(self, key: str, default: Default, *, above: float) -> tuple[float, float] | Default: ...
    def pair(self, key: str, default: Any = _REQUIRED, *, above: float) -> Any:
        """Two floats > `above`: [across, down], or one number for both."""
        value = self.take(key, default)
        if key not in self._values:
            return value
        single = _number(value)
        parsed = (single, single) if single is not None else _numbers(value, 2)
        if parsed is None or not all(isfinite(x) and x > above for x in parsed):
            raise self.bad(key, f"a number above {above:g}, or two of them [across, down]")
        return parsed

    def points(self, key: str) -> tuple[tuple[float, float], ...]:
        """A tuple of (u, v) pairs of finite floats."""
        value = self.take(key)
        parsed = [_numbers(item, 2) for item in value] if isinstance(value, list) else [None]
        if not parsed or any(item is None for item in parsed):
            raise self.bad(key, "a list of [u, v] points in m")
        return tuple((item[0], item[1]) for item in parsed if item is not None)

    @overload
    def table(self, key: str) -> "Table": ...
    @overload
    def table(self, key: str, default: Default) -> "Table | Default": ...
    def table(self, key: str, default: Any = _REQUIRED) -> Any:
        value = self.take(key, default)
        if key not in self._values:
            return value
        if not isinstance(value, dict):
            raise self.bad(key, "a table")
        return Table(value, f"{self.where}: {key}")

    def tables(self, key: str) -> list["Table"]:
        """The [[key]] tables; none where the key is absent."""
        value = self.take(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.bad(key, f"[[{key}]] tables")
        return [Table(item, f"{self.where}: {key}[{i}]") for i, item in enumerate(value)]

    def finish(self) -> None:
        """Refuse keys that nothing asked for."""
        for table in self._dotted.values():
            table.finish()
        for key in self._values:
            if key not in self._known:
                missing = sorted(self._known - set(self._values))
                raise InputError(f"{self.where}: unknown key {key}{nearest(key, missing or sorted(self._known))}")


DESIGN, STUDY = "fabdesign.design/1", "fabdesign.study/1"


def load_toml(path: Path, form: str, *, partial: bool = False) -> Table:
    """The root table of a file whose `format` is `form`; with `partial` (an included file) `format` may be absent."""
    root = Table(parse_toml(path), str(path), path)
    given = root.text("format", None)
    if given is None and not partial:
        raise InputError(f'{path}: no format line; expected format = "{form}"')
    if given == DESIGN and form == STUDY:
        raise InputError(
            f'{path}: a design; expected a study, a file with kind = "optimize" or another, design = "{path.name}" and '
            'for a search [target] with file = "CLOUD.ply" (tutorial, step 4)'
        )
    if given is not None and given != form:
        raise InputError(f'{path}: format is "{given}"; this version reads "{form}"')
    return root


def nearest(word: str, known: Sequence[str]) -> str:
    """' (did you mean X?)' where one of the known words is close, else nothing."""
    close = get_close_matches(word, known, n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | Decimal):
        return None
    try:
        return float(value)
    except OverflowError:
        return float("inf")


def _numbers(value: Any, count: int | None) -> tuple[float, ...] | None:
    if not isinstance(value, list) or (count is not None and len(value) != count):
        return None
    parsed = [_number(item) for item in value]
    if any(item is None or not isfinite(item) for item in parsed):
        return None
    return tuple(item for item in parsed if item is not None)


def _range(what: str, above: float | None, least: float | None, most: float | None) -> str:
    limits = []
    if above is not None:
        limits.append(f"above {above:g}")
    if least is not None:
        limits.append(f"from {least:g}")
    if most is not None:
        limits.append(f"to {most:g}")
    return " ".join([what, *limits])


def _shown(value: Any) -> str:
    text = _as_toml(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _as_toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_as_toml, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key} = {_as_toml(item)}' for key, item in value.items())}}}"
    return f'"{value}"' if isinstance(value, str) else str(value)
