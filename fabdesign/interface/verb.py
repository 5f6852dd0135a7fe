"""The declaration of a verb: its function. The command comes from its signature and docstring (`cli/command.py`).

A docstring begins with what the command's help says. Lines "NAME: sentence", indented where they go on, describe
parameters; a word of WORDS needs none. What follows after an empty line is about Python alone. Nothing heavy is
imported here or at the top of a file of verbs: `--help` loads them all.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, TypedDict, TypeVar

from fabdesign.runtime.effort import COARSEST, FINEST

if TYPE_CHECKING:
    from pathlib import Path

    from fabdesign.nouns.design import Design
    from fabdesign.nouns.model import Model
    from fabdesign.nouns.trial import MeasurementSet

File: TypeAlias = "Path | str"
Folder: TypeAlias = "Path | str"  # to write
Toml: TypeAlias = "Path | str"  # to write
Npz: TypeAlias = "Path | str"  # to write
DesignLike: TypeAlias = "Design | Path | str"
ModelLike: TypeAlias = "Model | Path | str"
SetLike: TypeAlias = "MeasurementSet | Path | str"
Pressures: TypeAlias = Any  # a program, a file of one, "400,0" or kPa of every channel; a sequence of these
Progress = Callable[[str, float | None], None]
Say = Callable[[str], None]
Function = TypeVar("Function", bound=Callable[..., Any])


class Writing(TypedDict, total=False):
    """The options of every verb that writes."""

    force: bool


class Working(Writing, total=False):
    """The options of a verb that takes a while, besides; of a command both go to standard error."""

    progress: Progress
    say: Say


class Extending(TypedDict, total=False):
    """The options of a verb that knows effects."""

    effects: Sequence[File]


class Computing(Working, Extending, total=False):
    """The options of a verb that asks for batches, besides."""

    cluster: str | None


class Placing(TypedDict, total=False):
    """How clouds and meshes are read: as a study's target."""

    unit: Literal["m", "cm", "mm", "in"]
    place: Literal["given", "fit"]
    rotation: Sequence[float] | None


class Looking(Working, Extending, Placing, total=False):
    """The options of a verb that shows such files beside a model's."""


class Word(NamedTuple):
    """The meaning of a parameter's name in every verb. ends: the least and the most; None: open. option: the
    command's, where it is not the name. repeated: given once for each, not separated by commas."""

    sentence: str = ""
    ends: tuple[float | None, float | None] | None = None
    option: str = ""
    repeated: bool = False
    metavar: str | None = None


WORDS = {
    "all_trials": Word(option="--all"),
    "cluster": Word(
        "Address of a Dask scheduler; its workers compute. By default the one in the study, or this machine alone.",
        metavar="ADDRESS",
    ),
    "effects": Word(
        "A Python file with your own effects, which models use by name; the file is executed.", repeated=True
    ),
    "force": Word("Replace existing output when the new one is complete; a folder only if fabdesign made it."),
    "grid": Word("Grid points per side; by default the model's, or 41.", (COARSEST, FINEST)),
    "hold": Word("With --equilibrium: time for which they then hold, s; by default 10.", (0, 3600)),
    "hold_out": Word(repeated=True, metavar="DESIGN"),
    "markers": Word(option="--marker", repeated=True, metavar="NAME=U,V"),
    "model": Word("A model file; by default the data sheet."),
    "muscle_type": Word(metavar="NAME"),
    "order": Word(ends=(0, None)),
    "out": Word("The folder to write to."),
    "place": Word("Where clouds and meshes lie, as in a study: as given, or registered to the hanging cloth (fit)."),
    "points": Word("Points sampled per frame.", (1, 100_000)),
    "port": Word("Port; by default the first free one from 8080.", (1, 65535)),
    "pressures": Word(repeated=True),
    "rise": Word("With --equilibrium: time in which the pressures rise, s; by default 1.", (0.01, 60)),
    "rotation": Word("Turns of clouds and meshes about the fixed axes x, y, z in this order, degrees, as in a study."),
    "seconds": Word("Time limit, s; by default the study's."),
    "seed": Word("Seed of what is drawn by chance.", (0, None)),
    "skip_bad": Word("Leave out invalid trials of a set, and list them."),
    "times": Word(option="--time", repeated=True),
    "unit": Word("Unit of clouds and meshes, as in a study; by default metres, or what a file says."),
    "without": Word("Parts of the model to leave out, separated by commas: rig, sensors, corrector, spread."),
}


class Shown(NamedTuple):
    """The output of a command: what `--json` prints, text, lines on standard error; and how it exits."""

    content: Any
    text: str
    lines: Sequence[str] = ()
    code: int = 0


@dataclass(frozen=True)
class Verb:
    """A verb of a user, in Python and in the shell.

    shown: of the result and the arguments by name; None: nothing is printed. arguments: parameters that are arguments
    of the command too, with what its usage calls them ("": as click does); by default the first. hidden: parameters
    that are no options of it. optional: whether the command goes without `-o`. from_shell: changes arguments, by name,
    from what is typed; may return the verb that is called in its place. title: of the progress; by default the first
    argument's name. interval: s between its lines. search: whether it is that of a search.
    """

    function: Callable[..., Any]
    shown: Callable[[Any, Mapping[str, Any]], Shown] | None
    arguments: Mapping[str, str]
    hidden: Sequence[str] = ()
    optional: bool = False
    from_shell: Callable[[dict[str, Any]], Verb | None] = lambda _: None
    title: str = ""
    interval: float = 0.0
    search: bool = False


VERBS: dict[str, Verb] = {}  # by the command's words: "studies list" is one of a group


def verb(
    shown: Callable[[Any, Mapping[str, Any]], Shown] | None,
    metavar: str = "",
    *,
    name: str | None = None,
    more: Mapping[str, str] | None = None,
    **how: Any,
) -> Callable[[Function], Function]:
    """Declare a function as a verb.

    metavar: what usage calls its first parameter, which is the command's argument; in brackets it may be left out,
    before "..." given many times. more: further arguments. name: the command's, by default the function's. how: fields
    of `Verb`.
    """

    def declare(function: Function) -> Function:
        first = next(iter(inspect.signature(function).parameters))
        arguments = {} if first in ("out", "given") else {first: metavar, **(more or {})}
        VERBS[name or function.__name__] = Verb(function, shown, arguments, **how)
        return function

    return declare


def unheard(line: str, share: float | None) -> None:
    """Drop progress that nobody follows."""


def warn(line: str) -> None:
    """Say a line as a warning of the caller's."""
    warnings.warn(line, stacklevel=4)
