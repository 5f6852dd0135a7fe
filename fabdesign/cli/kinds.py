"""Kinds of what is typed: numbers within limits, paths, files to write."""

import os
from math import isfinite
from pathlib import Path
from typing import Any

import click

from fabdesign.errors import InputError


class _Finite(click.types.FloatParamType):
    """A float that is neither infinite nor NaN."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        number = super().convert(value, param, ctx)
        if not isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


class NumberRange(_Finite, click.FloatRange):
    """A number within limits, which the help shows."""


class IntegerRange(click.IntRange):
    """A whole number within limits, which the help shows."""

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
TURN = _Turn()
