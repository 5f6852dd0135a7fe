"""Dataclasses as what files hold: the keys that `decoder` reads, with units in comments where a person edits it."""

import os
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import Float, Trivia

from fabdesign.formats.schema import FileUnit, file_keys, unit_of


class Encoder:
    """Turns dataclasses into what TOML takes. file: names of others are relative to its folder. names: writes an object
    that has a file of its own, and returns what the key says."""

    def __init__(
        self, file: Path, names: Mapping[type, Callable[[Any], str]] | None = None, *, comments: bool = False
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
            table[name] = self._item(value, unit_of(each.type, each.notes))
            comment = ", ".join(filter(None, (each.notes.unit.symbol if each.notes.unit else "", each.sentence)))
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


def plain(thing: Any) -> dict[str, Any]:
    """Return the table of a dataclass that names no files."""
    table: dict[str, Any] = Encoder(Path()).encode(thing)
    return table
