"""Designs, pressures, outputs and studies as they come: objects, files or numbers, one or many."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design
from fabdesign.files.pressure_file import constant_program, read_pressures
from fabdesign.interface.run import as_given, many_of, require_kind, several
from fabdesign.interface.verb import DesignLike, Pressures
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import PressureProgram, require_pressures
from fabdesign.units import from_kpa


def one_design(design: DesignLike) -> Design:
    """Return a design, read where it is a file. Raises InputError for anything else."""
    require_kind("design", design, Design)
    return design if isinstance(design, Design) else read_design(design)


def asked_study(
    read: Callable[[Any], Any], design: Any, keys: Mapping[str, Any], asked: Mapping[str, Any] | None, model: Any
) -> Any:
    """Return the study that is asked of a design in Python; where nothing is asked, `design` is its file, as the
    command takes it. keys: further ones of the study. Raises InputError."""
    if asked is not None:
        name = {} if design is None else {"name": (design := one_design(design)).name}
        return read({**name, **keys, **asked, "design": design, "model": model})
    if not isinstance(design, Path | str):
        raise InputError(f"{getattr(design, 'name', design)}: a design alone; expected what is asked of it, or a study")
    return Path(design)


def one_program(pressures: Pressures, design: Design) -> PressureProgram:
    """Return the pressures of a design; None: of one without channels. Raises InputError."""
    if pressures is None:
        if design.channels:
            raise InputError(f"{design.name}: has {design.channels} channels; expected --pressures for them")
        return constant_program([])
    if isinstance(pressures, Path | str):
        return read_pressures(pressures, design)
    if not isinstance(pressures, PressureProgram):
        try:
            row = np.asarray(pressures, dtype=float)
        except (TypeError, ValueError):
            row = np.empty((0, 0))
        if row.ndim != 1:
            raise InputError(f"pressures of {design.name}: {as_given(pressures)}; expected kPa of every channel")
        pressures = constant_program(from_kpa(row))
    require_pressures(pressures, design, f"pressures of {design.name}")
    return pressures


def pairs(
    designs: DesignLike | Sequence[DesignLike], pressures: Pressures
) -> tuple[list[tuple[Design, PressureProgram]], bool]:
    """Return designs with their pressures, and whether it is one pair alone. One design goes with all pressures, one
    row of pressures with all designs; else they are as many. Raises InputError."""
    read = [one_design(each) for each in several("designs", designs, Design)]
    are_many = _are_many(pressures)
    rows = [*pressures] if are_many else [pressures]
    if len(read) == 1:
        read *= len(rows)
    if len(rows) == 1:
        rows *= len(read)
    if not read or len(read) != len(rows):
        raise InputError(f"{len(read)} designs with {len(rows)} pressures; expected as many, or one of either")
    lone = isinstance(designs, Design | Path | str) and not are_many
    return [(design, one_program(row, design)) for design, row in zip(read, rows, strict=True)], lone


def _are_many(pressures: Pressures) -> bool:
    if pressures is None or isinstance(pressures, Path | str | PressureProgram):
        return False
    return any(not np.isscalar(each) for each in many_of("pressures", pressures))


def functions_of(outputs: Any) -> dict[str, Callable[..., float]]:
    """Return functions of a motion by name. Raises InputError for anything else."""
    functions = dict(outputs) if isinstance(outputs, Mapping) else {}
    if not functions:
        raise InputError("outputs: none; expected functions of a motion, by name")
    for name, function in functions.items():
        if not callable(function):
            raise InputError(f"outputs: {name}: {as_given(function)}; expected a function of a motion")
    return functions


def ends_of(what: str, given: Any) -> tuple[Any, Any]:
    """Return the least and the most. Raises InputError for what is no pair."""
    ends = [*given] if isinstance(given, Iterable) and not isinstance(given, Mapping) else []
    if len(ends) != 2:
        raise InputError(f"{what}: {as_given(given)}; expected two, the least and the most")
    return ends[0], ends[1]
