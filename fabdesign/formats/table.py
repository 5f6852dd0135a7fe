"""Tables of TOML files, each with where it stands, and which of its keys were asked for."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from fabdesign.errors import InputError
from fabdesign.formats.toml_file import parse_toml


class Table:
    """One table of a file, or what Python gives in its place. `finish` refuses the keys that nothing asked for."""

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
        """Return whether the key is there; from now on it is a known one."""
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
        return self._values.get(key) is not None

    def names(self) -> list[str]:
        """Return the keys, in the file's order."""
        return list(self._values)

    def bad(self, key: str, expected: str) -> InputError:
        """Return the error for a value that is not what was expected."""
        text = _as_toml(self._values.get(key))
        shown = text if len(text) <= 60 else text[:57] + "..."
        return InputError(f"{self.where}: {key} = {shown}; expected {expected}")

    def finish(self) -> None:
        """Refuse keys that nothing asked for."""
        for table in self._dotted.values():
            table.finish()
        for key in self._values:
            if key not in self._known:
                missing = sorted(self._known - set(self._values))
                raise InputError(f"{self.where}: unknown key {key}{nearest(key, missing or sorted(self._known))}")


DESIGN, STUDY = "fabdesign.design/1", "fabdesign.study/1"


def load_toml(path: Path, form: str) -> Table:
    """Return the root table of a file whose `format` is `form`."""
    root = load_part(path, form)
    if not root.has("format"):
        raise InputError(f'{path}: no format line; expected format = "{form}"')
    return root


def load_part(path: Path, form: str) -> Table:
    """Return the root table of a file, such as an included one, whose `format` is `form` or absent."""
    root = Table(parse_toml(path), str(path), path)
    given = root["format"] if root.has("format") else None
    if not isinstance(given, str | None):
        raise root.bad("format", "a text")
    if given == DESIGN and form == STUDY:
        raise InputError(
            f'{path}: a design; expected a study, a file with kind = "optimize" or another, design = "{path.name}" and '
            'for a search [target] with file = "CLOUD.ply" (tutorial, step 4)'
        )
    if given is not None and given != form:
        raise InputError(f'{path}: format is "{given}"; this version reads "{form}"')
    return root


def nearest(word: str, known: Sequence[str]) -> str:
    """Return ' (did you mean X?)' where one of the known words is close, else nothing."""
    close = get_close_matches(word, known, n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def _as_toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_as_toml, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key} = {_as_toml(item)}' for key, item in value.items())}}}"
    return f'"{value}"' if isinstance(value, str) else str(value)
