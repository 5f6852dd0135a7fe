"""Dataclasses from what files hold, strictly: unknown and missing keys, other types and values out of range are refused
in one line. A value may also be the object itself, so that Python gives a `Design` where a file names one. And back
again, with units in comments where a person edits the file."""

import os
from collections.abc import Callable, Mapping
from dataclasses import MISSING, is_dataclass, replace
from decimal import Decimal
from math import isfinite
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import tomlkit
from tomlkit.items import Float, Trivia

from fabdesign.formats.schema import FileKey, FileUnit, Notes, annotated, file_keys, members, unit_of
from fabdesign.formats.table import Table, nearest
from fabdesign.formats.toml_file import file_name

Form = TypeVar("Form")


def decode(form: type[Form], table: Table, usual: Form | None = None) -> Form:
    """Return the dataclass that a table holds, resolved. usual: has the values of keys that are absent, in place of the
    form's defaults. Raises InputError, also for keys that the form does not have."""
    made = decode_part(form, table, usual)
    table.finish()
    return resolved(made, table)


def decode_part(form: type[Form], table: Table, usual: Form | None = None) -> Form:
    """Decode as `decode` does, where the table may have other keys; not resolved."""
    keys = file_keys(form)
    if usual is not None:
        keys = tuple(replace(each, default=getattr(usual, each.field)) for each in keys)
    there = {each.field: _present(each, table) for each in keys}  # so that all are known before one is missed
    late = [each for each in keys if not _read_key(each, table, there[each.field])]
    for each in late:
        table.decoded[each.field] = _absent(each, table)
    return form(**{each.field: table.decoded[each.field] for each in keys})


def decode_key(hint: Any, table: Table, key: str, default: Any = None) -> Any:
    """Return the value of one key by its type; `default` where it is not there. Raises InputError."""
    return _value(annotated(hint), table[key], table, key) if table.has(key) else default


def resolved(made: Any, table: Table) -> Any:
    """Return a dataclass as its own checks leave it."""
    return made.resolved(table) if hasattr(made, "resolved") else made


def _present(each: FileKey, table: Table) -> list[str]:
    """Return the names of a field's key, or of its keys, that are there."""
    key, holder = each.notes.key, table.within(each.tables)
    names = filter(None, (*(key.one_of or (each.name,)), key.also))
    return [] if key.inside or key.rest else [name for name in names if holder.has(name)]


def _read_key(each: FileKey, table: Table, there: list[str]) -> bool:
    """Put the value of a key that is there among what is decoded. Raises InputError for one that must be there."""
    key = each.notes.key
    holder = table.within(each.tables)
    if key.inside:
        form = members(each.notes.type)[0]
        if each.default is None and file_keys(form)[0].name not in table:
            return False
        same = table.same()
        table.decoded[each.field] = resolved(decode_part(form, same), same)
        return True
    if key.one_of and not key.several and (len(there) > 1 or (not there and each.default is MISSING)):
        raise holder.error(f"expected {key.expected}")
    if not there:
        if each.name and each.default is MISSING and key.absent is None and not key.rest:
            raise holder.missing(each.name, key.expected)
        return False
    usual = each.default if is_dataclass(each.default) else None
    values = []
    for name in there:
        notes = annotated(key.one_of[name]) if key.one_of else each.notes
        values.append(_value(notes, holder[name], holder, name, usual))
    kind = each.notes.type
    if key.one_of and get_origin(kind) is tuple and is_dataclass(get_args(kind)[0]):
        values = [tuple(one for value in values for one in (value if isinstance(value, tuple) else (value,)))]
    table.decoded[each.field] = values[0]
    return True


def _absent(each: FileKey, table: Table) -> Any:
    key, holder = each.notes.key, table.within(each.tables)
    if key.rest and key.read is not None:
        return key.read(holder.take_rest(), holder)
    if key.absent is not None:
        return key.absent(table)
    if is_dataclass(each.default) and each.name:  # as an empty table, whose defaults may depend on others
        return decode(members(each.notes.type)[0], holder.within((each.name,)), each.default)
    return each.default


def _value(notes: Notes, value: Any, table: Table, key: str, usual: Any = None) -> Any:
    """Return a value of a file as its type has it. Raises InputError."""
    if notes.key.form is not None:
        value = _value(annotated(notes.key.form), value, table, key, usual)
    if notes.key.read is not None and (value := notes.key.read(value, table)) is None:
        raise table.bad(key, notes.key.expected)
    if notes.key.read is not None or notes.key.form is not None:
        return value
    kind, origin, arguments = notes.type, get_origin(notes.type), get_args(notes.type)
    if (kinds := members(kind)) != (kind,):
        each = [annotated(one, notes) for one in kinds]
        return _value(next((one for one in each if _alike(one.type, value)), each[-1]), value, table, key, usual)
    if kind is Any or (is_dataclass(kind) and isinstance(kind, type) and isinstance(value, kind)):
        return value
    if notes.key.file is not None:
        if not isinstance(value, str | Path):
            raise table.bad(key, "a text")
        # a path from Python or from another file is relative to no folder
        return notes.key.file(value if isinstance(value, Path) else _beside(table, value))
    if isinstance(kind, type) and is_dataclass(kind) and isinstance(value, Mapping):
        return decode(kind, table.inner(key), usual)
    if origin is Mapping and isinstance(value, Mapping):
        inner = table.inner(key)
        return {name: _value(annotated(arguments[1], notes), inner[name], inner, name) for name in inner.names()}
    if origin is tuple and isinstance(item := arguments[0], type) and is_dataclass(item):
        if not _is_list(value) or not all(isinstance(each, Mapping | item) for each in value):
            raise table.bad(key, f"[[{key}]] tables")
        tables = [table.inner(key, i) for i in range(len(value))]
        return tuple(v if isinstance(v, item) else decode(item, t) for v, t in zip(value, tables, strict=True))
    if origin is tuple and _is_list(value) and (arguments[-1] is ... or len(value) == len(arguments)):
        list_key = replace(notes.key, expected=expected_of(notes, value))  # errors of an item name the whole list
        item = annotated(arguments[0], replace(notes, key=list_key))
        return tuple(_value(item, one, table, key) for one in value)
    if (read := _scalar(notes, value, table)) is not None:
        if notes.key.there is not None and not notes.key.there(read):
            raise table.error(f"{key} {read} is not there")
        return read
    raise table.bad(key, expected_of(notes, value))


def _beside(table: Table, name: str) -> Path:
    """Return a file by its name, relative to the one that names it."""
    return table.file.parent / file_name(name, table.where)


def _is_list(value: Any) -> bool:
    return isinstance(value, list | tuple) or hasattr(value, "__array__")


def _alike(kind: Any, value: Any) -> bool:
    """Return whether a value has the shape of a member of a union."""
    origin = get_origin(kind)
    if isinstance(value, str):
        return kind in (str, Path) or origin is Literal
    if isinstance(value, Mapping):
        return origin is Mapping or is_dataclass(kind)
    return (origin is tuple) if _is_list(value) else kind in (float, int, bool)


def _scalar(notes: Notes, value: Any, table: Table) -> Any:
    """Return a number, text, flag or file; None where the value is not of that kind."""
    kind = notes.type
    if kind is float and (number := as_number(value)) is not None:
        fits = isfinite(number) and notes.within.holds(number)
        return (notes.unit.read(value) if notes.unit else number) if fits else None
    if kind is bool:
        return value if isinstance(value, bool) else None
    if kind is int:
        integer = isinstance(value, Integral) and not isinstance(value, bool)
        return int(value) if integer and notes.within.holds(value) else None
    if kind is Path and isinstance(value, Path):
        return value
    if not isinstance(value, str):
        return None
    if kind is Path:
        return _beside(table, value)
    return value if kind is str or value in get_args(kind) else None


def as_number(value: Any) -> float | None:
    """Return a number of a file or of Python; None for any other value."""
    if isinstance(value, bool) or not isinstance(value, Real | Decimal):
        return None
    try:
        return float(value)
    except OverflowError:
        return float("inf")


def expected_of(notes: Notes, value: Any = None) -> str:
    """Return what a key of that type may be, in words."""
    if notes.key.expected:
        return notes.key.expected
    kind, origin, arguments = notes.type, get_origin(notes.type), get_args(notes.type)
    if origin is Literal:
        return "one of " + ", ".join(arguments) + (nearest(value, arguments) if isinstance(value, str) else "")
    if origin is tuple:
        if get_origin(arguments[0]) is tuple:
            count = len(get_args(arguments[0]))
            return "a list of [u, v] points in m" if count == 2 else f"rows of {count} numbers"
        many = {str: "texts", int: "whole numbers"}.get(members(annotated(arguments[0]).type)[0], "numbers")
        return f"a list of {many}" if arguments[-1] is ... else f"a list of {len(arguments)} {many}"
    words = {float: "a number", int: "a whole number", bool: "true or false", str: "a text", Path: "a text"}
    return words.get(kind, "a table") + str(notes.within)


class Encoder:
    """Turns dataclasses into what TOML takes. file: names of others are relative to its folder. names: writes an object
    that has a file of its own, and returns what the key says."""

    def __init__(
        self, file: Path = Path(), names: Mapping[type, Callable[[Any], str]] | None = None, *, comments: bool = False
    ) -> None:
        self._folder, self._names, self._comments = file.parent, names or {}, comments

    def encode(self, thing: Any) -> Any:
        """Return the table of a dataclass; what is None is left out."""
        root: Any = tomlkit.table() if self._comments else {}
        for each in file_keys(type(thing)):
            value, table = getattr(thing, each.field), root
            brief = each.notes.key.brief and value == each.default
            if value is None or brief or not (name := next(iter(each.notes.key.one_of), each.name)):
                continue
            for outer in each.tables:
                table = table.setdefault(outer, {})
            table[name] = self._item(value, unit_of(each.notes))
            comment = ", ".join(filter(None, (each.notes.unit.symbol if each.notes.unit else "", each.notes.sentence)))
            if self._comments and comment:
                table[name].comment(comment)
        return root

    def _item(self, value: Any, unit: FileUnit | None) -> Any:
        if type(value) in self._names:
            return self._names[type(value)](value)
        if is_dataclass(value):
            return self.encode(value)
        if isinstance(value, Mapping):
            return {name: self._item(each, unit) for name, each in value.items()}
        if hasattr(value, "tolist"):
            return self._item(value.tolist(), unit)
        if isinstance(value, tuple | list):
            return [self._item(each, unit) for each in value]
        if isinstance(value, Path):
            return Path(os.path.relpath(value, self._folder)).as_posix()
        if isinstance(value, float):
            number = unit.write(value) if unit else value
            if not isinstance(number, Decimal):
                return number
            text = f"{number.normalize():f}"  # with all its digits, and no zeros behind them
            return Float(float(number), Trivia(), text if "." in text else text + ".0")
        return value
