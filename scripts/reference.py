"""The tables of docs that are made from the code: keys of files, commands, effects, and thresholds of the methods.

python scripts/reference.py            # writes them between their marks
python scripts/reference.py --check    # exits with 1 where they are not current
"""

import ast
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin

import click
import numpy as np

from fabdesign.cli import commands
from fabdesign.effects.registry import EFFECTS, markdown_table
from fabdesign.formats.codec import expected_of
from fabdesign.formats.schema import FileKey, Notes, annotated, members, unit_of, walk
from studies.check.design import STUDIES
from studies.check.files import KINDS

ROOT = Path(__file__).resolve().parents[1]
PAGES = tuple(sorted((ROOT / "docs").glob("*.md")))
MARKED = re.compile(r"(<!-- (keys|commands|effects|thresholds)(?:: ([a-z -]+))? -->\n).*?(<!-- end -->)", re.DOTALL)
HEADER = "| table | key | is | absent | meaning |\n|---|---|---|---|---|\n"
SHARED = ("--force", "--json", "--effects", "--cluster")  # said once, above the commands


class Threshold(NamedTuple):
    """A constant that a page names: its file, or the room where it stands once; what it decides; its unit."""

    place: str
    name: str
    decides: str
    unit: str = ""
    factor: float = 1.0


THRESHOLDS = {
    "trace": (
        Threshold("studies/fitting", "EXCESS", "excess that counts as nothing (`--tolerance`)", "mm", 1e3),
        Threshold("studies/benches", "TOLERANCE", "the same on a bench", "% of the largest output", 100),
        Threshold("studies/measured", "TRIALS", "trials used, at most"),
        Threshold("fabdesign/nouns", "LEAST_TRIALS", "trials with different pressures, at least"),
        Threshold("studies/measured", "GRID", "grid of the simulator (`--grid`)", "points a side"),
        Threshold("optimize/fit/balance.py", "FRAMES", "frames of a trial in balance"),
        Threshold("optimize/fit/balance.py", "WIDEST", "time that five frames around one may span", "s"),
        Threshold("optimize/fit", "NEEDED", "an effect that there is less evidence for is dropped", "log likelihood"),
        Threshold("studies/model_selection", "CAUSE", "a weaker effect is no cause", "deviations of its prior"),
        Threshold("studies/model_selection", "CHANCE", "share of the decoys that an effect must beat", "%", 100),
        Threshold("studies/model_selection", "GROSS", "excess that effects may leave", "times the tolerance"),
        Threshold("studies/model_selection", "LEAST_SHARE", "excess that effects must remove", "%", 100),
        Threshold(
            "studies/model_selection", "STRUCTURE", "excess from which on a kind of feature is structure", "%", 100
        ),
        Threshold("optimize/fit", "ALIKE", "cosine from which on two effects look the same"),
        Threshold("studies/model_selection", "LEAST_SHARE", "excess that a formula must remove", "%", 100),
        Threshold("studies/tracing", "LEAST_DIFFERENCE", "an experiment must show more", "mm RMS", 1e3),
    ),
    "sensitive stretches": (
        Threshold("studies/measured", "TILT", "tilt of gravity that is tried", "degrees"),
        Threshold("studies/measured", "PRESSURE", "change of each pressure that is tried", "%", 100),
        Threshold("studies/measured", "DRAWS", "draws of the data sheet's prior"),
        Threshold("studies/measured", "SHARE", "share of the draws that must be sensitive", "%", 100),
        Threshold("studies/prediction/stability.py", "OF_MOTION", "distance of two motions, of their size", "%", 100),
        Threshold("studies/prediction/stability.py", "LEAST", "smallest size of a motion", "mm", 1e3),
    ),
    "calibrate": (
        Threshold("studies/measured", "TRIALS", "trials fitted without effects, at most"),
        Threshold("studies/calibration", "MOST_TRIALS", "trials fitted with effects, at most"),
        Threshold("studies/fitting", "EXCESS", "excess of a reliable fit, at most", "mm", 1e3),
        Threshold("studies/fitting", "OUTLYING", "outlying frames of a reliable fit", "%", 100),
        Threshold("optimize/fit", "FAR", "an outlying frame has more", "times the median residual"),
        Threshold("optimize/fit", "BLOCK", "time that counts as one observation of a trial", "s"),
        Threshold("optimize/fit", "MODES", "observations in such a block, at most"),
        Threshold("studies/intervals", "LEAST", "trials from which on motions get intervals"),
    ),
    "search": (
        Threshold("optimize/search", "AGREE", "restarts that must agree"),
        Threshold("optimize/search", "ALIKE", "how near they must be", "%", 100),
        Threshold("optimize/search", "IDLE", "restarts without a gain that end a search"),
        Threshold("optimize/search", "NO_GAIN", "a smaller gain is none", "%", 100),
        Threshold("optimize/search", "MARGIN", "a result so near the best is as near", "%", 100),
        Threshold("studies/layout_search", "PRESSURE_STARTS", "starts drawn for pressures"),
        Threshold("studies/layout_search", "LAYOUT_STARTS", "layouts drawn"),
        Threshold("studies/layout_search", "COARSE", "coarse model", "points a side"),
        Threshold("studies/layouts", "SHRINKING", "seconds kept for fewer muscles", "%", 100),
        Threshold("studies/layouts", "ROBUST", "seconds kept for a robust layout", "%", 100),
        Threshold("studies/layouts", "LEAST_GAP", "out of reach: gap over the noise floor", "mm", 1e3),
        Threshold("studies/layouts", "GAP", "and share of the noise floor", "%", 100),
        Threshold("studies/prediction/stability.py", "OFF", "change of the pressures of a copy", "%", 100),
        Threshold("studies/prediction/stability.py", "LEAST", "another stable shape: distance", "mm RMS", 1e3),
        Threshold("studies/prediction/stability.py", "OF_SHAPE", "and share of the motion", "%", 100),
    ),
    "sensitivity": (
        Threshold("studies/sensitivity", "WIDE", "width of a Sobol interval that is warned of"),
        Threshold("studies/prediction/stability.py", "OFF", "change of the pressures that is tried", "%", 100),
        Threshold("studies/prediction/stability.py", "LEAST", "sum of both moves that is a snap", "mm RMS", 1e3),
        Threshold("studies/sensitivity", "MANY_SNAP", "share of snaps that is warned of", "%", 100),
    ),
}


def with_tables(page: str) -> str:
    """Return the page with every marked table as the code has it now."""
    made = {
        "keys": table_of,
        "commands": command_tables,
        "effects": lambda _: markdown_table(EFFECTS) + "\n",
        "thresholds": thresholds,
    }
    return MARKED.sub(lambda mark: mark[1] + made[mark[2]](mark[3]) + mark[4], page)


def thresholds(of: str) -> str:
    """Return the table of the thresholds of a method, with the file of each."""
    rows = []
    for each in THRESHOLDS[of]:
        file, value = standing(each)
        rows.append(f"| {each.decides} | {f'{each.factor * value:g} {each.unit}'.strip()} | `{file}` |\n")
    return "| what | value | where |\n|---|---|---|\n" + "".join(rows)


def standing(each: Threshold) -> tuple[str, float]:
    """Return the file of a constant and its value. Raises ValueError where it stands nowhere, or in several files."""
    place = ROOT / each.place
    constants = []
    for file in [place] if place.is_file() else sorted(place.glob("*.py")):
        constants += [
            (file.relative_to(ROOT).as_posix(), ast.literal_eval(node.value))
            for node in ast.parse(file.read_text(encoding="utf-8")).body
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == each.name
        ]
    if len(constants) != 1:
        raise ValueError(f"{each.place}: {len(constants)} constants {each.name}; expected one")
    return constants[0]


def command_tables(_: str | None) -> str:
    """Return a heading, a sentence, the usage and the options of every command."""
    return "\n".join(_command(name, command) for name, command in _commands(commands, ""))


def _commands(group: Any, before: str) -> Iterator[tuple[str, click.Command]]:
    for name, command in sorted(group.commands.items()):
        if isinstance(command, click.Group):
            yield from _commands(command, f"{before}{name} ")
        else:
            yield before + name, command


def _command(name: str, command: click.Command) -> str:
    context = click.Context(command, info_name=f"fabdesign {name}")
    usage = " ".join(piece for piece in command.collect_usage_pieces(context) if piece != "[OPTIONS]")
    records = (each.get_help_record(context) for each in command.params if isinstance(each, click.Option))
    rows = [record for record in records if record is not None]
    flags = [option.split(" ")[0] for option, _ in rows]
    option_rows = [row for row, flag in zip(rows, flags, strict=True) if flag not in SHARED]
    shared = [f"`{flag}`" for flag in SHARED if flag in flags]
    lines = [
        f"### {name}\n",
        f"{' '.join((command.help or '').split())}\n",
        f"```\n{f'fabdesign {name} {usage}'.strip()}\n```\n",
    ]
    if option_rows:
        lines += [
            "| option | means |",
            "|---|---|",
            *(f"| `{_cell(option)}` | {_cell(text)} |" for option, text in option_rows),
            "",
        ]
    return "\n".join([*lines, f"Also: {', '.join(shared)}.\n"])


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("  ", " ")


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
        yield (_place((*above, *each.tables)), key, _what(each), _absent(each), each.notes.sentence)
    for each in keys:
        form, brackets = _form_of(each)
        if form is not None:
            place = (*above, *each.tables, "NAME" if each.notes.key.rest else brackets.replace("KEY", each.name))
            yield (_place(place), "", "", _absent(each), each.notes.sentence)
            if each.name != "targets":  # whose keys are those of [target]
                yield from _rows((form,), place, each.default)


def _place(names: tuple[str, ...]) -> str:
    """Return the header of a table as a file has it."""
    double = any(name.startswith("[") for name in names)
    path = ".".join(name.strip("[]") for name in names)
    return "" if not path else f"`[[{path}]]`" if double else f"`[{path}]`"


def _form_of(each: FileKey) -> tuple[Any, str]:
    """Return the dataclass that a key's table is decoded to, None for a value; and how its header is written."""
    kind = _in_file(each.notes).type
    if get_origin(kind) is Mapping and is_dataclass((inner := annotated(get_args(kind)[1])).type):
        return (None, "") if inner.key.file else (inner.type, "KEY.NAME")
    if get_origin(kind) is tuple and is_dataclass(form := get_args(kind)[0]):
        return form, "[KEY]"
    return (kind, "KEY") if is_dataclass(kind) and each.notes.key.file is None else (None, "")


def _in_file(notes: Notes) -> Notes:
    """Return the type that stands in the file, and what is said of it."""
    return _in_file(annotated(notes.key.form)) if notes.key.form is not None else notes


def _what(each: FileKey) -> str:
    """Return what a value is: choices, or a sort of value with its unit and limits."""
    notes = _in_file(each.notes)
    kind = notes.type
    if notes.key.file or kind is Path:
        return "a file"
    first = members(kind)[0]
    if get_origin(first) is Literal:
        return ", ".join(f"`{choice}`" for choice in get_args(first)) + (" or points" if len(members(kind)) > 1 else "")
    if get_origin(first) is Mapping:
        return "NAME = a file" if annotated(get_args(first)[1]).key.file else "NAME = value"
    if get_origin(first) is np.ndarray:
        return "rows of numbers"
    words = [] if first is Any else [expected_of(annotated(first, Notes(within=notes.within)))]
    if get_origin(first) is tuple and get_origin(get_args(first)[0]) is Literal:
        return "some of " + ", ".join(f"`{choice}`" for choice in get_args(get_args(first)[0]))
    if len(members(kind)) > 1:
        words = [expected_of(annotated(one)) for one in members(kind)]
    unit = unit_of(each.notes)
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
    if isinstance(default, tuple) and default and all(isinstance(one, float) for one in default):
        unit = unit_of(each.notes)
        return f"`[{', '.join(f'{float(unit.write(one)) if unit else one:g}' for one in default)}]`"
    return f"`{default}`" if isinstance(default, str) and default else ""


if __name__ == "__main__":
    wrong = 0
    for page in PAGES:
        old = page.read_text(encoding="utf-8")
        if (new := with_tables(old)) != old:
            wrong += 1
            if "--check" not in sys.argv:
                page.write_text(new, encoding="utf-8")
    sys.exit(bool(wrong) and "--check" in sys.argv)
