"""What the commands share: the group, options, how they print, and where their batches are computed."""

import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fabdesign import __version__
from fabdesign.cache_folder import ensure_cache_folder
from fabdesign.effort import COARSEST, FINEST
from fabdesign.errors import InputError, InputNote, printable
from fabdesign.json_file import json_text

if TYPE_CHECKING:
    from fabdesign.model import Model


class _Finite(click.types.FloatParamType):
    """A float that is neither infinite nor NaN."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        number = super().convert(value, param, ctx)
        if not isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


class NumberRange(_Finite, click.FloatRange):
    """The same within limits, which the help shows."""


class IntegerRange(click.IntRange):
    """Within limits, which the help shows."""

    name = "integer"


class NamedPath(click.Path):
    """A path that has a name: a variable of the shell that is not set is none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not os.fspath(value):
            raise InputError("an empty name; expected that of a file or folder")
        return super().convert(value, param, ctx)


class OutputPath(NamedPath):
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


FILE = NamedPath(path_type=Path)
FOLDER = OutputPath()
FINITE = _Finite()
SECONDS = NumberRange(min=0, min_open=True)
GRID = IntegerRange(COARSEST, FINEST)
SEED = IntegerRange(0)
grid_option = click.option("--grid", type=GRID, help="Grid points per side; by default the model's, or 41.")


def target_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options by which clouds and meshes are read as a study's target, as one argument `how`."""

    @click.option(
        "--unit",
        type=click.Choice(["m", "cm", "mm", "in"]),
        default="m",
        help="Unit of clouds and meshes, as in a study; by default metres, or what a file says.",
    )
    @click.option(
        "--place",
        type=click.Choice(["given", "fit"]),
        default="given",
        help="Where clouds and meshes lie, as in a study: as given, or registered to the hanging cloth (fit).",
    )
    @click.option(
        "--rotation",
        type=_Turn(),
        help="Turns of clouds and meshes about the fixed axes x, y, z in this order, degrees, as in a study.",
    )
    @wraps(command)
    def with_target(*, unit: Any, place: Any, rotation: Any, **values: Any) -> None:
        from fabdesign.target_file import AsTarget

        command(how=AsTarget(unit, place, rotation=rotation), **values)

    return with_target


force_option = click.option(
    "--force",
    is_flag=True,
    help="Replace existing output when the new one is complete; a folder only if fabdesign made it.",
)
skip_bad_option = click.option("--skip-bad", is_flag=True, help="Leave out invalid trials of a set, and list them.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print a machine-readable result.")


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
def commands() -> None:
    """Design fabric actuators: a cloth with McKibben muscles laced through it.

    Files and options are in metres, seconds, newtons and kPa; errors are shown in millimetres.
    """
    ensure_cache_folder()


def print_result(result: Mapping[str, Any], text: str, as_json: bool) -> None:
    click.echo(json_text(result) if as_json else printable(text))


def tell(line: str) -> None:
    """On standard error."""
    click.echo(printable(line), err=True)


def points_per_side(grid: int | None, model: "Model | None") -> int:
    """Of the grid: as asked for, else what the model's factors were found on."""
    from fabdesign.model import Model

    return grid or (model or Model()).points_per_side


MOST = 10  # lines of a command: a set may have one a trial


@contextmanager
def notes_told() -> Iterator[None]:
    """Show each `InputNote` once, as "note: ...", and MOST of them; other warnings as Python does."""
    told: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if not isinstance(message, InputNote):
            before(message, category, *place, **more)
        elif str(message) not in told:
            told.add(str(message))
            if len(told) <= MOST:
                tell(f"note: {' '.join(str(message).split())}")
            elif len(told) == MOST + 1:
                tell("note: there are more of these; fabdesign check lists all of a file or folder")

    with warnings.catch_warnings():
        before = warnings.showwarning
        warnings.simplefilter("always", InputNote)
        warnings.showwarning = show
        yield


def _connect(context: click.Context, parameter: click.Parameter, address: str | None) -> None:
    from fabdesign.cluster import on_cluster

    study: Path | None = context.params.get("study")
    if address is None and study is not None:
        from fabdesign.study_file import read_cluster

        address = read_cluster(study)
    context.with_resource(on_cluster(address, say=tell))


cluster_option = click.option(
    "--cluster", envvar="FABDESIGN_CLUSTER", show_envvar=True, metavar="ADDRESS", expose_value=False, callback=_connect,
    help="Address of a Dask scheduler; its workers compute. By default the one in the study, or this machine alone.",
)  # fmt: skip
