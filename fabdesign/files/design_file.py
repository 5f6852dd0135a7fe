"""Design files: `fabdesign.design/1`, read, and written as a commented TOML with its tables beside it."""

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import tomlkit

from fabdesign.effects.registry import effect_named
from fabdesign.errors import InputError
from fabdesign.files import law_tables
from fabdesign.formats.codec import Encoder, decode, decode_key, decode_part
from fabdesign.formats.table import DESIGN, Table, load_part, load_toml
from fabdesign.formats.toml_file import file_name, parse_toml
from fabdesign.nouns.design import MUSCLE_TYPES, Design, Term
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.model import EffectTerm, Quantity
from fabdesign.nouns.muscle import Muscle, MuscleType
from fabdesign.output import atomic_file
from fabdesign.runtime.effort import MUSCLES

FORMAT = DESIGN


@dataclass(frozen=True)
class DesignHead:
    """The keys that a design's file, or one that it includes, has beside the design."""

    include: Annotated[tuple[str, ...], "files whose [fabric] keys, muscle types and effects are added"] = ()
    effects: Annotated[
        tuple[EffectTerm, ...],
        "that a bench found, as in a model, of fabric or a muscle type (absent: the only type of the file); a model's "
        "effect of the same name and scope replaces it",
    ] = ()


@dataclass(frozen=True)
class DesignScene:
    """Keys of [fabric] that may stand at top level of a design, whose cloth may be another file's."""

    support: Annotated[Any, "as in [fabric]"] = None
    hung: Annotated[Any, "as in [fabric]"] = None
    gravity: Annotated[Any, "as in [fabric]"] = None


def read_design(path: Path | str) -> Design:
    """Read a design with all the files that it names.

    Paths inside a file are relative to that file. `support`, `hung` and `gravity` belong to [fabric] and are taken
    at top level too. Raises InputError, one line, for anything that docs/files.md does not allow.
    """
    path = Path(path)
    root = load_toml(path, FORMAT)
    scene = {key: value for key, value in vars(decode_part(DesignScene, root)).items() if value is not None}
    fabrics, types, effects = _contents(root, ())
    if not fabrics:
        raise root.error("no [fabric] table")
    fabric = decode(Fabric, _merged(fabrics, scene))
    root.decoded = {"fabric": fabric, "muscle_types": types}
    muscles = decode_key(tuple[Muscle, ...], root, "muscles", ())
    if len(muscles) > MUSCLES:
        raise root.error(f"{len(muscles)} muscles; expected at most {MUSCLES}")
    root.finish()
    return Design(decode_key(str, root, "name", path.stem), fabric, types, muscles, tuple(effects))


@dataclass(frozen=True)
class DesignPart:
    """The content of a file that designs include: muscle types, and keys of a cloth, checked one by one."""

    types: Mapping[str, MuscleType]
    fabric: Fabric | None  # where the part has keys of one; those in `keys` are the part's own, the others a stand-in
    keys: frozenset[str]
    effects: tuple[Term, ...] = ()  # found on a bench, that a design which includes the part has


# what stands in for the keys that a part leaves to the design: any sound values do
_STAND_IN = {"width": 1, "height": 1, "poisson": 0} | dict.fromkeys(
    ("thickness", "areal_density", "membrane_stiffness", "shear_stiffness", "bending_stiffness"), Decimal(1)
)


def is_part(path: Path) -> bool:
    """Return whether a file can only be included: without muscles, and without the size of a cloth."""
    root = parse_toml(path)
    fabric = root.get("fabric", {})
    sized = isinstance(fabric, dict) and {"width", "height"} <= fabric.keys()
    holds = "muscle_types" in root or bool(fabric)
    return holds and not sized and not {"muscles", "include"} & root.keys()


def read_part(path: Path | str) -> DesignPart:
    """Read a file that designs include. Raises InputError for what no design that includes it could read."""
    root = load_part(Path(path), FORMAT)
    fabrics, types, effects = _contents(root, ())
    root.finish()
    if not fabrics:
        return DesignPart(types, None, frozenset(), tuple(effects))
    given = _merged(fabrics, {})
    keys = given.names()
    complete = Table(_STAND_IN | {key: given[key] for key in keys}, given.where)
    return DesignPart(types, decode(Fabric, complete), frozenset(keys), tuple(effects))


class _Contents(NamedTuple):
    """The [fabric] tables, muscle types and effects of a file and of all that it includes."""

    fabrics: list[Table]
    types: dict[str, MuscleType]
    effects: list[Term]


def _contents(root: Table, above: tuple[Path, ...]) -> _Contents:
    path, above = root.file, (*above, root.file.resolve())
    fabrics: list[Table] = []
    types: dict[str, MuscleType] = {}
    effects: list[Term] = []
    decode_key(str, root, "name")
    head = decode_part(DesignHead, root)
    for name in head.include:
        included = path.parent / file_name(name, str(path))
        if included.resolve() in above:
            raise InputError(f"{path}: include {name} comes back to a file that includes it")
        if parse_toml(included).get("format") == law_tables.FORMAT:
            raise InputError(f"{path}: include {name}: {included} {law_tables.why_not_included(included)}")
        table = load_part(included, FORMAT)
        more_fabrics, more_types, more_effects = _contents(table, above)
        table.finish()
        fabrics += more_fabrics
        effects += more_effects
        for twice in set(types) & set(more_types):
            raise InputError(f"{path}: muscle type {twice} is in two included files")
        types |= more_types
    if decode_key(Mapping[str, Any], root, "fabric") is not None:
        fabrics.append(root.inner("fabric"))
    declared = decode_key(Mapping[str, MuscleType], root, "muscle_types", {})
    if again := next((name for name in declared if name in types), None):
        raise InputError(f"{path}: muscle type {again} is in an included file too")
    types |= declared
    for number, effect in enumerate(head.effects):
        effects.append(_of_bench(effect.term, types, where := root.inner("effects", number)))
        if [(e.name, e.scope) for e in effects].count((effects[-1].name, effects[-1].scope)) > 1:
            raise where.error(f"{effects[-1].name} of {effects[-1].scope} is there already")
    return _Contents(fabrics, types, effects)


def _of_bench(term: Term, types: Mapping[str, MuscleType], table: Table) -> Term:
    """Return what a bench found with its scope: the cloth or a muscle type, by default the only one of the file."""
    sort = effect_named(term.name, table.where).scope
    if sort not in ("fabric", "muscle type"):
        raise table.error(f"{term.name} belongs to the {sort}; expected it in a model, not in a design")
    known = ["fabric"] if sort == "fabric" else [MUSCLE_TYPES + name for name in types]
    scope = term.scope or (known[0] if len(known) == 1 else None)
    if scope not in known:
        raise table.error(f"scope is {scope or 'missing'}; expected {' or '.join(known) or 'a muscle type'}")
    return replace(term, scope=scope)


def _merged(tables: list[Table], scene: dict[str, Any]) -> Table:
    """Return one fabric table; a key may stand in one place only. Paths become independent of the file that names
    them."""
    values = dict(scene)
    for table in tables:
        for key in table.names():
            if key in values:
                elsewhere = "at top level" if key in scene else "in an included file"
                one = "; `fabdesign calibrate ACROSS DOWN -o CLOTH.toml` makes one curve of two strips"
                raise tables[-1].error(f"{key} stands {elsewhere} too{one if key == 'membrane_curve' else ''}")
            value = table[key]
            of_file = key == "membrane_curve" and isinstance(value, str)
            values[key] = table.file.parent / file_name(value, table.where) if of_file else value
    return Table(values, tables[-1].where, tables[-1].file)


def write_design(design: Design, path: Path | str) -> None:
    """Write a design; reading it gives an equal one.

    Bench tables go beside it as `TYPE_bench.csv` (`STEM_TYPE_bench.csv` where another table has that name already),
    a membrane curve as `STEM_membrane.csv`. Raises InputError where `path` cannot be written.
    """
    path = Path(path)
    with atomic_file(path) as unfinished:  # first, so that nothing lies beside a file that cannot be written
        unfinished.write_text(_text(design, path), encoding="utf-8", newline="\n")


def _text(design: Design, path: Path) -> str:
    """Return the TOML text; the tables that it names are written beside `path`."""
    benches = iter(_place_bench(kind, path, i) for i, kind in enumerate(design.muscle_types.values()))
    names = {
        law_tables.BenchTable: lambda bench: next(benches),
        law_tables.MembraneCurve: lambda curve: _place_curve(curve, path),
    }
    encoder = Encoder(path, names, comments=True)
    document = tomlkit.document()
    document["format"] = FORMAT
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
        effects = []
        for term in design.effects:
            declared = effect_named(term.name, "design").parameters
            values = {name: Quantity(value, declared[name].unit) for name, value in term.values.items()}
            effects.append(Encoder().encode(EffectTerm(term.name, values, term.scope)))
        document["effects"] = effects
    return tomlkit.dumps(document)


def _place_bench(kind: MuscleType, path: Path, index: int) -> str:
    """Write a bench table to the first place that is free or holds it already; the last place is overwritten."""
    bench, word = kind.bench, re.sub(r"[^a-z0-9]+", "_", kind.name.lower()).strip("_") or "muscle"
    stems = (word, f"{path.stem}_{word}", f"{path.stem}_{word}_{index}")
    places = [path.with_name(f"{stem}_bench.csv") for stem in stems]
    for place in places[:-1]:
        if not place.exists():
            break
        with suppress(InputError):
            if law_tables.read_bench_table(place) == bench:
                return place.name
    else:
        place = places[-1]
    law_tables.write_bench_table(bench, place)
    return place.name


def _place_curve(curve: law_tables.MembraneCurve, path: Path) -> str:
    place = path.with_name(f"{path.stem}_membrane.csv")
    law_tables.write_membrane_curve(curve, place)
    return place.name
