"""A kind of file is a frozen dataclass: its fields are the keys, and the types' annotations say units, limits and what
a key is for. `codec` reads and writes such files; `json_schema` is for editors.

    spacing: Annotated[Metre, FROM_0, "between muscles on one face"] = 0.006

A dataclass may have `resolved(table)`: what is checked across keys once all are read, and returned in its place.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from decimal import Decimal
from functools import cache
from math import isfinite
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from fabdesign.runtime.effort import COARSEST, FINEST
from fabdesign.units import from_mm, in_mm, kilopascals, pascals


@dataclass(frozen=True)
class FileUnit:
    """The unit of a number in files, and how it becomes the number that the code computes with."""

    symbol: str
    read: Callable[[Any], float] = float
    write: Callable[[float], float | Decimal] = float


def _pascals(number: float | Decimal) -> float:
    return pascals(number if isinstance(number, Decimal) else Decimal(repr(float(number))))


Metre = Annotated[float, FileUnit("m")]
Second = Annotated[float, FileUnit("s")]
Kilopascal = Annotated[float, FileUnit("kPa", _pascals, kilopascals)]  # Pa inside
KilopascalPerSecond = Annotated[float, FileUnit("kPa/s", _pascals, kilopascals)]  # Pa/s inside
MM = FileUnit("mm", lambda number: from_mm(float(number)), in_mm)
Millimetre = Annotated[float, MM]  # m inside


@dataclass(frozen=True)
class Within:
    """The limits of a number, in the file's unit: > above, >= least, <= most."""

    above: float | None = None
    least: float | None = None
    most: float | None = None

    def holds(self, number: float) -> bool:
        return (
            (self.above is None or number > self.above)
            and (self.least is None or number >= self.least)
            and (self.most is None or number <= self.most)
        )

    def __str__(self) -> str:
        words = {"above": self.above, "from": self.least, "to": self.most}
        return "".join(f" {word} {limit:g}" for word, limit in words.items() if limit is not None)


FROM_0, ABOVE_0, SHARE = Within(least=0), Within(above=0), Within(least=0, most=1)
GRIDS = Within(least=COARSEST, most=FINEST)  # points a side


@dataclass(frozen=True, eq=False)  # hashed by identity: types hold it
class Key:
    """How a field stands in a file, where its name and type do not say it all.

    name: in place of the field's, with a dot in a table; "": the field has no key. also: an older name that is read.
    form: the type that stands in the file, if it is another one. read: the value from that and its table, None where it
    does not fit. expected: what an error then says. file: reads the object from its own file, which the key names.
    there: whether what a path names is there, such as Path.is_file. absent: the value where the key is not there, from
    the table. one_of: keys of which one is there, with their types; several: or more of them, whose values are joined.
    inside: the fields of a dataclass stand in the same table. rest: all keys that no other field takes. brief: not
    written where it is the default.
    """

    name: str | None = None
    also: str = ""
    expected: str = ""
    file: Callable[[Any], Any] | None = None
    there: Callable[[Path], bool] | None = None
    read: Callable[[Any, Any], Any] | None = None
    absent: Callable[[Any], Any] | None = None
    form: Any = None
    one_of: Mapping[str, Any] = field(default_factory=dict)
    several: bool = False
    inside: bool = False
    rest: bool = False
    brief: bool = False


@dataclass(frozen=True)
class Notes:
    """A type without its annotations, and what they say of a value."""

    type: Any = Any
    key: Key = Key()
    unit: FileUnit | None = None
    within: Within = Within()
    sentence: str = ""


@dataclass(frozen=True)
class FileKey:
    """A field of a dataclass, as its file has it."""

    field: str
    tables: tuple[str, ...]  # that the key stands in, within the table of the dataclass
    name: str
    notes: Notes
    default: Any = None  # MISSING where there is none


def _file_keys(form: Any) -> tuple[FileKey, ...]:
    """Return the keys of a dataclass in the order of its fields."""
    hints = get_type_hints(form, include_extras=True)
    return tuple(file_key(each.name, hints[each.name], each) for each in fields(form) if each.init)


def file_key(name: str, hint: Any, field: Any) -> FileKey:
    """Return the key of a dataclass's field by its type."""
    factory = getattr(field, "default_factory", MISSING)
    default = getattr(field, "default", MISSING) if factory is MISSING else factory()
    notes = annotated(hint)
    if len(kinds := members(notes.type)) == 1:  # None stands for a key that is not there
        notes = replace(annotated(kinds[0], notes), sentence=notes.sentence)
    *tables, key = (notes.key.name if notes.key.name is not None else name).split(".")
    return FileKey(name, tuple(tables), key, notes, default)


file_keys: Callable[[Any], tuple[FileKey, ...]] = cache(_file_keys)


def annotated(hint: Any, outer: Notes = Notes()) -> Notes:
    """Return a type and what its annotations say; what the outer ones say is kept, but for the sentence."""
    if get_origin(hint) is not Annotated:
        return replace(outer, type=hint, sentence="")
    plain, *marks = get_args(hint)
    key, unit, within = outer.key, outer.unit, outer.within
    for mark in marks:
        key = mark if isinstance(mark, Key) else key
        unit = mark if isinstance(mark, FileUnit) else unit
        within = mark if isinstance(mark, Within) else within
    sentence = next((mark for mark in marks if isinstance(mark, str)), "")
    return Notes(plain, key, unit, within, sentence)


def members(hint: Any) -> tuple[Any, ...]:
    """Return the types of a union but None; of any other type itself."""
    if get_origin(hint) not in (Union, UnionType):
        return (hint,)
    return tuple(member for member in get_args(hint) if member is not NoneType)


def unit_of(notes: Notes) -> FileUnit | None:
    """Return the unit that a value of a file has, or each of a list."""
    if notes.unit is not None or notes.key.form is not None:
        return notes.unit or unit_of(annotated(notes.key.form))
    kind = notes.type
    inner = get_args(kind)[:1] if get_origin(kind) is tuple else members(kind) if members(kind) != (kind,) else ()
    return next(filter(None, (unit_of(annotated(each, notes)) for each in inner)), None)


def walk(form: type) -> Iterator[FileKey]:
    """Yield the keys of a table, with those of dataclasses whose fields stand in the same one."""
    for each in file_keys(form):
        if each.notes.key.inside:
            yield from walk(members(each.notes.type)[0])
        elif each.notes.key.one_of:
            for name, kind in each.notes.key.one_of.items():
                yield FileKey(each.field, each.tables, name, annotated(kind))
        elif each.name:
            yield each


_PLAIN = {float: "number", int: "integer", bool: "boolean", str: "string", Path: "string"}
_LIMITS = {"above": "exclusiveMinimum", "least": "minimum", "most": "maximum"}


def json_schema(kind: str, forms: tuple[type, ...], required: Sequence[str] = ("format",)) -> dict[str, Any]:
    """Return the schema of a file of that kind, whose keys are those of all forms. required: keys beside them."""
    form = f"fabdesign.{kind}/1"
    table = _table(forms)
    table["properties"] = {"format": {"const": form}} | table["properties"]
    table["required"] = [*required] + table["required"]
    return {"$schema": "http://json-schema.org/draft-07/schema#", "title": form} | table


def _table(forms: tuple[type, ...]) -> dict[str, Any]:
    root: dict[str, Any] = {"type": "object", "properties": {}, "required": [], "additionalProperties": False}
    for form in forms:
        optional_choice = {each.field for each in file_keys(form) if each.notes.key.one_of}
        for each in walk(form):
            table = root
            for name in each.tables:
                table = table["properties"].setdefault(name, _table(()))
            if each.notes.key.rest:
                table["additionalProperties"] = {"type": ["number", "string", "object"]}
                continue
            value = _value(each.notes)
            if each.notes.sentence or each.notes.unit:
                value["description"] = described(each.notes)
            default, unit = each.default, each.notes.unit
            if isinstance(default, bool | int | str) or (isinstance(default, float) and isfinite(default)):
                value["default"] = float(unit.write(default)) if unit and isinstance(default, float) else default
            table["properties"][each.name] = value
            if each.notes.key.also:
                table["properties"][each.notes.key.also] = dict(value, deprecated=True)
            if each.default is MISSING and each.notes.key.absent is None and each.field not in optional_choice:
                table["required"].append(each.name)
    return root


def described(notes: Notes) -> str:
    """Return the unit and the sentence of a key."""
    unit = unit_of(notes)
    return ", ".join(filter(None, (unit.symbol if unit else "", notes.sentence)))


def _value(notes: Notes) -> dict[str, Any]:
    kind = notes.type
    if notes.key.form is not None:
        return _value(annotated(notes.key.form))
    if notes.key.file is not None:
        return {"type": "string"}
    if len(kinds := members(kind)) > 1 or kinds != (kind,):
        each = [_value(annotated(one, notes)) for one in kinds]
        return each[0] if len(each) == 1 else {"anyOf": each}
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin is tuple:
        return {"type": "array", "items": _value(annotated(arguments[0], notes))} | (
            {} if arguments[-1] is ... else {"minItems": len(arguments), "maxItems": len(arguments)}
        )
    if origin is Mapping:
        return {"type": "object", "additionalProperties": _value(annotated(arguments[1], notes))}
    if isinstance(kind, type) and is_dataclass(kind):
        return _table((kind,))
    limits = {_LIMITS[name]: limit for name, limit in vars(notes.within).items() if limit is not None}
    return {"type": _PLAIN[kind]} | limits if kind in _PLAIN else {}
