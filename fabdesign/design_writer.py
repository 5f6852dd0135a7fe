"""Writing designs: a commented TOML, its bench tables and its membrane curve beside it."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import Array, Float, Item, Table, Trivia

from fabdesign.bench_table_file import read_bench_table, write_bench_table
from fabdesign.curve_file import write_membrane_curve
from fabdesign.design import Design
from fabdesign.effect_file import effect_items
from fabdesign.effects.registry import effect_named
from fabdesign.errors import InputError
from fabdesign.fabric import Fabric
from fabdesign.model import EffectTerm, Quantity
from fabdesign.muscle import BenchTable, Muscle, MuscleType
from fabdesign.output import whole_file
from fabdesign.term import Term
from fabdesign.units import kilopascals


def write_design(design: Design, path: Path | str) -> None:
    """Write a design; reading it gives an equal one.

    Bench tables go beside it as `TYPE_bench.csv` (`STEM_TYPE_bench.csv` where another table has that name already),
    a membrane curve as `STEM_membrane.csv`. Raises InputError where `path` cannot be written.
    """
    path = Path(path)
    with whole_file(path) as unfinished:  # first, so that nothing lies beside a file that cannot be written
        unfinished.write_text(_document(design, path), encoding="utf-8", newline="\n")


def _document(design: Design, path: Path) -> str:
    """The TOML text; the tables that it names are written beside `path`."""
    document = tomlkit.document()
    document["format"] = "fabdesign.design/1"
    document["name"] = design.name
    document["fabric"] = _fabric(design.fabric, path)
    types = tomlkit.table(is_super_table=True)
    for i, kind in enumerate(design.muscle_types.values()):
        bench = _place_bench(kind.bench, _bench_paths(path, kind.name, i))
        types[kind.name] = _muscle_type(kind, bench)
    if design.muscle_types:
        document["muscle_types"] = types
    if design.muscles:
        muscles = tomlkit.aot()
        for muscle in design.muscles:
            muscles.append(_muscle(muscle))
        document["muscles"] = muscles
    if design.effects:
        document["effects"] = [effect_items(_with_units(term)) for term in design.effects]
    if design.fabric.membrane_curve is not None:
        write_membrane_curve(design.fabric.membrane_curve, _curve_path(path))
    return tomlkit.dumps(document)


def _with_units(term: Term) -> EffectTerm:
    declared = effect_named(term.name, "design").parameters
    return EffectTerm(term.name, {k: Quantity(v, declared[k].unit) for k, v in term.values.items()}, term.scope)


def _fabric(fabric: Fabric, path: Path) -> Table:
    table = tomlkit.table()
    _add(table, "width", fabric.width, "m, across")
    _add(table, "height", fabric.height, "m, down")
    _add(table, "thickness", fabric.thickness, "m")
    _add(table, "areal_density", fabric.areal_density, "kg/m^2, without muscles")
    _add(table, "membrane_stiffness", fabric.membrane_stiffness, "N/m, across and down")
    if fabric.membrane_curve is not None:
        _add(table, "membrane_curve", _curve_path(path).name, "N/m over strain, replaces the stiffness it covers")
    _add(table, "shear_stiffness", fabric.shear_stiffness, "N/m")
    _add(table, "poisson", fabric.poisson, "nu_12")
    _add(table, "bending_stiffness", fabric.bending_stiffness, "N m, across and down")
    if fabric.twist_stiffness is not None:
        _add(table, "twist_stiffness", fabric.twist_stiffness, "N m")
    _add(table, "viscosity", fabric.viscosity, "N s/m, membrane")
    _add(table, "air_damping", fabric.air_damping, "N s/m^3")
    _add(table, "support", fabric.support, "pinned is free to turn, clamped is not")
    _add(table, "hung", fabric.hung, "an edge, none, or (u, v) points in m")
    _add(table, "gravity", fabric.gravity, "m/s^2")
    return table


def _muscle_type(kind: MuscleType, bench: str) -> Table:
    table = tomlkit.table()
    _add(table, "outer_diameter", kind.outer_diameter, "m")
    _add(table, "mass_per_length", kind.mass_per_length, "kg/m")
    _add(table, "viscosity", kind.viscosity, "N s, tension lost per contraction rate")
    _add(table, "axis_offset", kind.axis_offset, "m, of the laced axis from the mid-surface")
    _add(table, "bench", bench, "isometric force at pressure and contraction")
    if kind.max_pressure is not None:
        _add(table, "max_pressure", kilopascals(kind.max_pressure), "kPa")
    lengths: Mapping[str, float | None] = {
        "stock_length": kind.stock_length,
        "min_bend_radius": kind.min_bend_radius,
        "tail_length": kind.tail_length,
    }
    for key, value in lengths.items():
        if value is not None:
            _add(table, key, value, "m")
    return table


def _muscle(muscle: Muscle) -> Table:
    table = tomlkit.table()
    table["type"] = muscle.type
    table["side"] = muscle.side
    table["channel"] = muscle.channel
    _add(table, "path", muscle.path, "(u, v) m")
    _add(table, "fixed_point_pitch", muscle.fixed_point_pitch, "m")
    return table


def _add(table: Table, key: str, value: Any, comment: str) -> None:
    item = _item(value)
    item.comment(comment)
    table[key] = item


def _item(value: Any) -> Item:
    if isinstance(value, str):
        return tomlkit.string(value)
    if isinstance(value, tuple):
        array: Array = tomlkit.array()
        array.extend(_item(entry) for entry in value)
        return array
    text = repr(value) if isinstance(value, float) else f"{value:f}"
    return Float(float(value), Trivia(), text if "." in text or "e" in text else text + ".0")  # with all its digits


def _bench_paths(path: Path, name: str, index: int) -> tuple[Path, ...]:
    word = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "muscle"
    own = f"{path.stem}_{word}"
    return tuple(path.with_name(f"{stem}_bench.csv") for stem in (word, own, f"{own}_{index}"))


def _place_bench(bench: BenchTable, places: tuple[Path, ...]) -> str:
    """Write the table to the first place that is free or holds it already; the last place is overwritten."""
    for place in places[:-1]:
        if not place.exists():
            write_bench_table(bench, place)
            return place.name
        try:
            if read_bench_table(place) == bench:
                return place.name
        except InputError:
            continue
    write_bench_table(bench, places[-1])
    return places[-1].name


def _curve_path(path: Path) -> Path:
    return path.with_name(f"{path.stem}_membrane.csv")
