"""The tables of keys in docs (files.md, studies.md), from what dataclasses declare.

python scripts/file_tables.py            # writes them between their marks
python scripts/file_tables.py --check    # exits with 1 where they are not current
"""

import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import numpy as np

from fabdesign.formats.decoder import expected_of
from fabdesign.formats.schema import FileKey, Notes, annotated, members, unit_of, walk
from studies.check.kinds import KINDS, STUDIES

PAGES = tuple(Path(__file__).resolve().parents[1] / "docs" / name for name in ("files.md", "studies.md"))
MARKED = re.compile(r"(<!-- keys: ([a-z -]+) -->\n).*?(<!-- end -->)", re.DOTALL)
HEADER = "| table | key | is | absent | meaning |\n|---|---|---|---|---|\n"


def with_tables(page: str) -> str:
    """Return the page with every marked table as it is declared now."""
    return MARKED.sub(lambda mark: mark[1] + table_of(mark[2]) + mark[3], page)


def table_of(name: str) -> str:
    """Return the Markdown table of a kind of file, or of what a kind of study has beside an optimize study's keys."""
    forms = KINDS.get(name) or (STUDIES[name.removeprefix("study ")],)
    known = set() if name == "study optimize" else set(_rows((STUDIES["optimize"],), ()))
    rows = [row for row in _rows(forms, ()) if name in KINDS or row not in known]
    return HEADER + "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _rows(forms: tuple[type, ...], above: tuple[str, ...], usual: Any = None) -> Iterator[tuple[str, ...]]:
    """Yield a row for each key: those of the table itself, then of the tables in it. usual: has the defaults."""
    keys = [each for form in forms for each in walk(form)]
    if is_dataclass(usual):
        keys = [replace(each, default=getattr(usual, each.field)) for each in keys]
    plain = [each for each in keys if _form_of(each)[0] is None]
    for each in sorted(plain, key=lambda each: each.tables):
        key = "any other" if each.notes.key.rest else f"`{each.name}`"
        yield (_place((*above, *each.tables)), key, _what(each), _absent(each), each.sentence)
    for each in keys:
        form, brackets = _form_of(each)
        if form is not None:
            place = (*above, *each.tables, "NAME" if each.notes.key.rest else brackets.replace("KEY", each.name))
            yield (_place(place), "", "", _absent(each), each.sentence)
            if each.name != "targets":  # whose keys are those of [target]
                yield from _rows((form,), place, each.default)


def _place(names: tuple[str, ...]) -> str:
    """Return the header of a table as a file has it."""
    double = any(name.startswith("[") for name in names)
    path = ".".join(name.strip("[]") for name in names)
    return "" if not path else f"`[[{path}]]`" if double else f"`[{path}]`"


def _form_of(each: FileKey) -> tuple[Any, str]:
    """Return the dataclass that a key's table is decoded to, None for a value; and how its header is written."""
    kind = _in_file(each.type, each.notes)[0]
    if get_origin(kind) is Mapping and is_dataclass(form := annotated(get_args(kind)[1])[0]):
        inner = annotated(get_args(kind)[1])[1]
        return (None, "") if inner.key.file else (form, "KEY.NAME")
    if get_origin(kind) is tuple and is_dataclass(form := get_args(kind)[0]):
        return form, "[KEY]"
    return (kind, "KEY") if is_dataclass(kind) and each.notes.key.file is None else (None, "")


def _in_file(hint: Any, outer: Notes) -> tuple[Any, Notes]:
    """Return the type that stands in the file, and what is said of it."""
    kind, notes, _ = annotated(hint, outer)
    return _in_file(notes.key.form, Notes()) if notes.key.form is not None else (kind, notes)


def _what(each: FileKey) -> str:
    """Return what a value is: choices, or a sort of value with its unit and limits."""
    kind, notes = _in_file(each.type, each.notes)
    if notes.key.file or kind is Path:
        return "a file"
    first = members(kind)[0]
    if get_origin(first) is Literal:
        return ", ".join(f"`{choice}`" for choice in get_args(first)) + (" or points" if len(members(kind)) > 1 else "")
    if get_origin(first) is Mapping:
        return "NAME = a file" if annotated(get_args(first)[1])[1].key.file else "NAME = value"
    if get_origin(first) is np.ndarray:
        return "rows of numbers"
    words = [] if first is Any else [expected_of(*annotated(first, Notes(within=notes.within))[:2])]
    if get_origin(first) is tuple and get_origin(get_args(first)[0]) is Literal:
        return "some of " + ", ".join(f"`{choice}`" for choice in get_args(get_args(first)[0]))
    if len(members(kind)) > 1:
        words = [expected_of(*annotated(one)[:2]) for one in members(kind)]
    unit = unit_of(each.type, each.notes)
    text = ", ".join(filter(None, (" or ".join(words).replace(" in m", ""), unit.symbol if unit else "")))
    return text.replace("a number above 0, or two of them [across, down]", "a number above 0, or [across, down]")


def _absent(each: FileKey) -> str:
    """Return the default as a file would have it; an asterisk where the key must be there."""
    if each.default is MISSING:
        return "" if each.notes.key.absent or each.notes.key.rest else "*"
    default = each.default
    if isinstance(default, bool):
        return "`true`" if default else "`false`"
    if isinstance(default, float | int) and abs(default) != float("inf"):
        unit = each.notes.unit
        return f"`{float(unit.write(default)):g}`" if unit and isinstance(default, float) else f"`{default:g}`"
    return f"`{default}`" if isinstance(default, str) and default else ""


if __name__ == "__main__":
    wrong = False
    for file in PAGES:
        old = file.read_text(encoding="utf-8")
        new = with_tables(old)
        wrong |= old != new
        if old != new and "--check" not in sys.argv:
            file.write_text(new, encoding="utf-8")
    sys.exit(wrong and "--check" in sys.argv)
