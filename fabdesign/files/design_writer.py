"""Writing designs: a commented TOML, its bench tables and its membrane curve beside it."""

import re
from pathlib import Path

import tomlkit

from fabdesign.effects.registry import effect_named
from fabdesign.errors import InputError
from fabdesign.files.bench_table_file import BenchTable, read_bench_table, write_bench_table
from fabdesign.files.curve_file import MembraneCurve, write_membrane_curve
from fabdesign.formats.encoder import Encoder, plain
from fabdesign.nouns.design import Design, Term
from fabdesign.nouns.model import EffectTerm, Quantity
from fabdesign.output import whole_file


def write_design(design: Design, path: Path | str) -> None:
    """Write a design; reading it gives an equal one.

    Bench tables go beside it as `TYPE_bench.csv` (`STEM_TYPE_bench.csv` where another table has that name already),
    a membrane curve as `STEM_membrane.csv`. Raises InputError where `path` cannot be written.
    """
    path = Path(path)
    with whole_file(path) as unfinished:  # first, so that nothing lies beside a file that cannot be written
        unfinished.write_text(_document(design, path), encoding="utf-8", newline="\n")


def _document(design: Design, path: Path) -> str:
    """Return the TOML text; the tables that it names are written beside `path`."""
    benches = iter(
        _place_bench(kind.bench, _bench_paths(path, kind.name, i))
        for i, kind in enumerate(design.muscle_types.values())
    )
    names = {BenchTable: lambda bench: next(benches), MembraneCurve: lambda curve: _place_curve(curve, path)}
    encoder = Encoder(path, names, comments=True)
    document = tomlkit.document()
    document["format"] = "fabdesign.design/1"
    document["name"] = design.name
    document["fabric"] = encoder.encode(design.fabric)
    if design.muscle_types:
        types = tomlkit.table(is_super_table=True)
        for kind in design.muscle_types.values():
            types[kind.name] = encoder.encode(kind)
        document["muscle_types"] = types
    if design.muscles:
        muscles = tomlkit.aot()
        for muscle in design.muscles:  # what keys mean is said once
            muscles.append(Encoder(path, comments=not muscles).encode(muscle))
        document["muscles"] = muscles
    if design.effects:
        document["effects"] = [plain(_with_units(term)) for term in design.effects]
    return tomlkit.dumps(document)


def _with_units(term: Term) -> EffectTerm:
    declared = effect_named(term.name, "design").parameters
    return EffectTerm(term.name, {k: Quantity(v, declared[k].unit) for k, v in term.values.items()}, term.scope)


def _bench_paths(path: Path, name: str, index: int) -> tuple[Path, ...]:
    word = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "muscle"
    written = f"{path.stem}_{word}"
    return tuple(path.with_name(f"{stem}_bench.csv") for stem in (word, written, f"{written}_{index}"))


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


def _place_curve(curve: MembraneCurve, path: Path) -> str:
    place = path.with_name(f"{path.stem}_membrane.csv")
    write_membrane_curve(curve, place)
    return place.name
