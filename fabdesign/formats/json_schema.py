"""JSON Schemas of kinds of files for editors, from what their dataclasses declare."""

from collections.abc import Mapping
from dataclasses import MISSING, is_dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from fabdesign.formats.schema import FileKey, Notes, annotated, file_keys, members, unit_of, walk

_PLAIN = {float: "number", int: "integer", bool: "boolean", str: "string", Path: "string"}
_LIMITS = {"above": "exclusiveMinimum", "least": "minimum", "most": "maximum"}


def json_schema(kind: str, forms: tuple[type, ...], *, format_line: bool = True) -> dict[str, Any]:
    """Return the schema of a file of that kind, whose keys are those of all forms. format_line: it must have one."""
    form = f"fabdesign.{kind}/1"
    table = _table(forms)
    table["properties"] = {"format": {"const": form}} | table["properties"]
    table["required"] = ["format"] * format_line + table["required"]
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
            value = _value(each.type, each.notes)
            if each.sentence or each.notes.unit:
                value["description"] = described(each)
            if _shown(each.default):
                value["default"] = each.default
            table["properties"][each.name] = value
            if each.notes.key.also:
                table["properties"][each.notes.key.also] = dict(value, deprecated=True)
            if each.default is MISSING and each.notes.key.absent is None and each.field not in optional_choice:
                table["required"].append(each.name)
    return root


def described(each: FileKey) -> str:
    """Return the unit and the sentence of a key."""
    unit = unit_of(each.type, each.notes)
    return ", ".join(filter(None, (unit.symbol if unit else "", each.sentence)))


def _shown(default: Any) -> bool:
    return isinstance(default, bool | int | str) or (isinstance(default, float) and isfinite(default))


def _value(hint: Any, outer: Notes) -> dict[str, Any]:
    kind, notes, _ = annotated(hint, outer)
    if notes.key.form is not None:
        return _value(notes.key.form, Notes())
    if notes.key.file is not None:
        return {"type": "string"}
    if len(kinds := members(kind)) > 1 or kinds != (kind,):
        each = [_value(one, notes) for one in kinds]
        return each[0] if len(each) == 1 else {"anyOf": each}
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin is tuple:
        return {"type": "array", "items": _value(arguments[0], notes)} | (
            {} if arguments[-1] is ... else {"minItems": len(arguments), "maxItems": len(arguments)}
        )
    if origin is Mapping:
        return {"type": "object", "additionalProperties": _value(arguments[1], notes)}
    if isinstance(kind, type) and is_dataclass(kind):
        return _table((kind,))
    limits = {_LIMITS[name]: limit for name, limit in vars(notes.within).items() if limit is not None}
    return {"type": _PLAIN[kind]} | limits if kind in _PLAIN else {}
