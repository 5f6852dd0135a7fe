"""A verb becomes a command: its options from the function's signature, their help from the docstring and WORDS, their
kinds, such as numbers within limits, paths and files to write, from the annotations."""

import ast
import inspect
import os
import re
from collections.abc import Mapping
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import click

from fabdesign.cli.console import commands, described, print_result, tell
from fabdesign.errors import InputError
from fabdesign.interface import verb as declared
from fabdesign.interface.verb import VERBS, WORDS, Verb, Word


class _Finite(click.types.FloatParamType):
    """A float that is neither infinite nor NaN."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        number = super().convert(value, param, ctx)
        if not isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


class _NumberRange(_Finite, click.FloatRange):
    """A number within limits, which the help shows."""


class _IntegerRange(click.IntRange):
    """A whole number within limits, which the help shows."""

    name = "integer"


class _NamedPath(click.Path):
    """A path that has a name: a variable of the shell that is not set is none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not os.fspath(value):
            raise InputError("an empty name; expected that of a file or folder")
        return super().convert(value, param, ctx)


class _OutputPath(_NamedPath):
    """A file to write, whose name ends in `ending` or in nothing that is another format's; without `ending` a folder.

    `view` makes what shows a motion.
    """

    _SHOWN = (".html", ".png", ".gif", ".mp4", ".glb", ".pvd", ".rrd")
    _FORMATS = (
        *_SHOWN, ".npz", ".npy", ".csv", ".tsv", ".txt", ".json", ".toml", ".svg", ".pdf", ".dxf", ".jpg", ".jpeg",
        ".mov", ".avi", ".webm", ".mkv", ".vtu", ".vtk", ".gltf", ".ply", ".obj", ".stl", ".pcd", ".xyz", ".zip", ".db",
        ".sqlite", ".parquet", ".xlsx", ".bag", ".mcap", ".safetensors", ".md", ".yaml",
    )  # fmt: skip

    def __init__(self, ending: str | None = None) -> None:
        super().__init__(path_type=Path)
        self._ending = ending

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        ending = path.suffix.lower()
        if ending in self._FORMATS and ending != self._ending:
            expected = "the name of a folder" if self._ending is None else f"a name that ends in {self._ending}"
            more = ""
            if self._ending == ".npz" and ending in self._SHOWN:
                more = f"; fabdesign view {path.with_suffix('.npz')} -o {path} then makes that"
            raise InputError(f"{path}: ends in {ending}, another format; expected {expected}{more}")
        return path


class _Turn(click.ParamType[tuple[float, ...]]):
    """Three angles."""

    name = "X,Y,Z"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            angles = tuple(float(cell) for cell in str(value).split(","))
        except ValueError:
            angles = ()
        if len(angles) != 3 or not all(abs(angle) <= 360 for angle in angles):
            raise InputError(f"--rotation {value}: expected three angles X,Y,Z in degrees, such as -90,0,0")
        return angles


def text(value: str) -> list[str]:
    """Return texts, separated by commas: click's type of this name."""
    return value.split(",") if value else []


# click's types, by how a parameter is annotated
_TYPES: Mapping[str, click.ParamType[Any]] = {
    "bool": click.BOOL,
    "float": _Finite(),
    "int": click.INT,
    "str": click.STRING,
    "Pressures": click.STRING,
    "Folder": _OutputPath(),
    "Npz": _OutputPath(".npz"),
    "Toml": _OutputPath(".toml"),
    **dict.fromkeys(("File", "DesignLike", "ModelLike", "SetLike"), _NamedPath(path_type=Path)),
}
_RANGES: Mapping[str, Any] = {"int": _IntegerRange, "float": _NumberRange}
_ABOVE_0 = _NumberRange(min=0, min_open=True)
_BY_NAME = {"rotation": _Turn(), "seconds": _ABOVE_0, "tolerance": _ABOVE_0}
_LAST = {"effects": 1, "cluster": 2, "out": 3, "force": 4}  # options that many share
_GROUPS = {"studies": "List, show and compare results."}
_NONE = inspect.Parameter.empty


def parse(docstring: str) -> tuple[str, dict[str, str]]:
    """Return what a docstring says of the command, and of each parameter."""
    text: list[str] = []
    for block in inspect.cleandoc(docstring).split("\n\n"):
        if sentences := re.findall(r"^(\w+): (.*(?:\n +.*)*)", block, re.MULTILINE):
            return "\n\n".join(text), {name: " ".join(sentence.split()) for name, sentence in sentences}
        text.append(block)
    return "\n\n".join(text), {}


def _signature(verb: Verb, sentences: Mapping[str, str]) -> list[tuple[str, str, Any]]:
    """Return name, annotation and default of what the command may have of what the function takes, and last what it
    shares with others. Where further keys of a study are taken, only what has a sentence is of the command."""
    given: list[tuple[str, str, Any]] = []
    for name, one in inspect.signature(verb.function).parameters.items():
        if one.kind is not one.VAR_KEYWORD:
            given.append((name, one.annotation, one.default))
            continue
        if one.annotation == "Any":
            given = [each for each in given if each[0] in {*sentences, *verb.arguments}]
        shared = re.sub(r"Unpack\[(\w+)\]", r"\1", one.annotation).replace("Any", "Computing")
        fields = getattr(declared, shared).__annotations__
        given += [(key, kind.__forward_arg__, None) for key, kind in fields.items()]
    return sorted((each for each in given if each[0] not in verb.hidden), key=lambda each: _LAST.get(each[0], 0))


def _parameter(verb: Verb, name: str, annotation: str, default: Any, sentence: str | None) -> click.Parameter | None:
    """Return what the command has of a parameter; None where Python alone can give it. A kind is the annotation without
    None, and without what Python takes besides."""
    word, several = WORDS.get(name, Word()), re.search(r"Sequence\[([\w| ]+)\]", annotation)
    kind = re.split(r" \| ", several[1] if several else annotation)[0]
    if not (kind in _TYPES or kind.startswith("Literal")):
        return None
    type_: click.ParamType[Any]
    if name in _BY_NAME:
        type_, several = _BY_NAME[name], None
    elif kind.startswith("Literal"):
        type_ = click.Choice([*ast.literal_eval(kind.removeprefix("Literal"))])
    else:
        type_ = _TYPES[kind] if word.ends is None else _RANGES[kind](*word.ends)
    if (shown := verb.arguments.get(name)) is not None:
        how: dict[str, Any] = {"required": not shown.startswith("["), "nargs": -1 if shown.endswith("...") else 1}
        return click.Argument([name], type=type_, metavar=shown or None, **how)
    names = ["-o", "--output"] if name == "out" else [word.option or f"--{name.replace('_', '-')}"]
    required = default is _NONE or (name == "out" and default is None and not verb.optional)
    more: dict[str, Any] = {"is_flag": True} if kind == "bool" else {"type": type_}
    if several:
        more |= {"multiple": True} if word.repeated else {"type": text}
    elif not any(default is none for none in (_NONE, None, False)):
        more |= {"default": default, "show_default": True}
    if name == "cluster":
        more |= {"envvar": "FABDESIGN_CLUSTER", "show_envvar": True}
    sentence = word.sentence if sentence is None else sentence
    return click.Option([*names, name], required=required, help=sentence, metavar=word.metavar, **more)


def _command(name: str, verb: Verb) -> click.Command:
    text, sentences = parse(verb.function.__doc__ or "")
    parameters = [_parameter(verb, *one, sentences.get(one[0])) for one in _signature(verb, sentences)]
    as_json = click.Option(["--json", "as_json"], is_flag=True, help="Print a machine-readable result.")
    params = [one for one in (*parameters, as_json) if one is not None]
    params.sort(key=lambda one: isinstance(one, click.Option))
    return click.Command(name, callback=partial(_call, verb), params=params, help=text)


def _call(verb: Verb, *, as_json: bool, **typed: Any) -> None:
    """Call the function with what was typed, show how far it is, and print what it gave."""
    given = {name: value for name, value in typed.items() if value is not None}
    verb = verb.from_shell(given) or verb
    parameters = inspect.signature(verb.function).parameters
    title = verb.title or Path(str(given.get(next(iter(parameters))))).stem
    if "announce" in parameters:
        given["announce"] = lambda address: print_result({"address": address}, address, as_json)
    if any(name == "progress" for name, *_ in _signature(verb, {})):
        with described(title, interval=verb.interval, of_search=verb.search) as shown:
            result = verb.function(**given, progress=shown, say=tell)
    else:
        result = verb.function(**given)
    if verb.shown is not None:
        shows = verb.shown(result, {name: one.default for name, one in parameters.items()} | given)
        for line in shows.lines:
            tell(line)
        print_result(shows.content, shows.text, as_json)
        if shows.code:
            raise SystemExit(shows.code)


def add_commands() -> None:
    """Add the command of every verb to the group; "GROUP NAME" becomes one of a group."""
    for words, verb in VERBS.items():
        *above, name = words.split()
        group: click.Group = commands
        for part in above:
            group = group.commands.get(part) or click.Group(part, help=_GROUPS[part])  # type: ignore[assignment]
            commands.add_command(group)
        group.add_command(_command(name, verb))
