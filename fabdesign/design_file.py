"""Design files: `fabdesign.design/1`. Read here, written by `design_writer`."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

from fabdesign.bench_law_file import FORMAT as BENCH_LAW
from fabdesign.bench_law_file import why_not_included
from fabdesign.bench_table_file import read_bench_table
from fabdesign.curve_file import MembraneCurve, read_membrane_curve
from fabdesign.design import Design
from fabdesign.design_writer import write_design
from fabdesign.effect_file import read_effect
from fabdesign.effects.registry import effect_named
from fabdesign.effort import CLOSEST, MUSCLES
from fabdesign.errors import InputError
from fabdesign.fabric import Fabric
from fabdesign.muscle import Muscle, MuscleType
from fabdesign.table import DESIGN, Table, load_toml, nearest
from fabdesign.term import MUSCLE_TYPES, Term
from fabdesign.toml_file import file_name, parse_toml

__all__ = ["DesignPart", "is_part", "read_design", "read_part", "write_design"]

FORMAT = DESIGN
EDGES = ("top", "bottom", "left", "right", "none")
_LARGEST = 10.0  # m; a cloth beyond it was surely meant in millimetres
_SLACK = 1e-9  # m, of rounding that a point on the border may have


def read_design(path: Path | str) -> Design:
    """Read a design with all the files that it names.

    Paths inside a file are relative to that file. `support`, `hung` and `gravity` belong to [fabric] and are taken
    at top level too. Raises InputError, one line, for anything that docs/files.md does not allow.
    """
    path = Path(path)
    root = load_toml(path, FORMAT)
    name = root.text("name", path.stem)
    scene = {key: root.take(key) for key in ("support", "hung", "gravity") if key in root}
    fabric_tables, types, effects = _contents(root, path, ())
    if not fabric_tables:
        raise InputError(f"{path}: no [fabric] table")
    fabric = _fabric(_merged(fabric_tables, scene))
    tables = root.tables("muscles")
    if len(tables) > MUSCLES:
        raise InputError(f"{path}: {len(tables)} muscles; expected at most {MUSCLES}")
    muscles = tuple(_muscle(table, fabric, types) for table in tables)
    root.finish()
    return Design(name, fabric, types, muscles, tuple(effects))


@dataclass(frozen=True)
class DesignPart:
    """What a file holds that designs include: muscle types, and keys of a cloth, checked one by one."""

    types: Mapping[str, MuscleType]
    fabric: Fabric | None  # where the part has keys of one; those in `keys` are the part's own, the others a stand-in
    keys: frozenset[str]
    effects: tuple[Term, ...] = ()  # found on a bench, that a design which includes the part has


# what stands in for the keys that a part leaves to the design: any sound values do
_STAND_IN = {"width": 1, "height": 1, "poisson": 0} | dict.fromkeys(
    ("thickness", "areal_density", "membrane_stiffness", "shear_stiffness", "bending_stiffness"), Decimal(1)
)


def is_part(path: Path) -> bool:
    """Whether a file can only be included: without muscles, and without the size of a cloth."""
    root = parse_toml(path)
    fabric = root.get("fabric", {})
    sized = isinstance(fabric, dict) and {"width", "height"} <= fabric.keys()
    holds = "muscle_types" in root or bool(fabric)
    return holds and not sized and not {"muscles", "include"} & root.keys()


def read_part(path: Path | str) -> DesignPart:
    """Read a file that designs include. Raises InputError for what no design that includes it could read."""
    path = Path(path)
    root = load_toml(path, FORMAT, partial=True)
    root.text("name", None)
    fabrics, types, effects = _contents(root, path, ())
    root.finish()
    if not fabrics:
        return DesignPart(types, None, frozenset(), tuple(effects))
    given = _merged(fabrics, {})
    keys = frozenset(given.names())
    values = _STAND_IN | {key: given.take(key) for key in given.names()}
    return DesignPart(types, _fabric(Table(values, given.where)), keys, tuple(effects))


def _contents(
    root: Table, path: Path, above: tuple[Path, ...]
) -> tuple[list[tuple[Path, Table]], dict[str, MuscleType], list[Term]]:
    """The [fabric] tables, muscle types and effects of a file and of all that it includes."""
    above = (*above, path.resolve())
    fabrics: list[tuple[Path, Table]] = []
    types: dict[str, MuscleType] = {}
    effects: list[Term] = []
    for name in root.texts("include", ()):
        included = path.parent / file_name(name, str(path))
        if included.resolve() in above:
            raise InputError(f"{path}: include {name} comes back to a file that includes it")
        if parse_toml(included).get("format") == BENCH_LAW:
            raise InputError(f"{path}: include {name}: {included} {why_not_included(included)}")
        table = load_toml(included, FORMAT, partial=True)
        table.text("name", None)
        more_fabrics, more_types, more_effects = _contents(table, included, above)
        table.finish()
        fabrics += more_fabrics
        effects += more_effects
        for twice in set(types) & set(more_types):
            raise InputError(f"{path}: muscle type {twice} is in two included files")
        types |= more_types
    if (fabric := root.table("fabric", None)) is not None:
        fabrics.append((path, fabric))
    if (tables := root.table("muscle_types", None)) is not None:
        for name in tables.names():
            if name in types:
                raise InputError(f"{path}: muscle type {name} is in an included file too")
            types[name] = _muscle_type(name, tables.table(name), path)
    for entry in root.tables("effects"):
        effects.append(_effect(entry, types))
        if [(e.name, e.scope) for e in effects].count((effects[-1].name, effects[-1].scope)) > 1:
            raise InputError(f"{entry.where}: {effects[-1].name} of {effects[-1].scope} is there already")
    return fabrics, types, effects


def _effect(table: Table, types: Mapping[str, MuscleType]) -> Term:
    """What a bench found: it belongs to the cloth or to a muscle type, without a scope to the only one of the file."""
    term = read_effect(table).term
    sort = effect_named(term.name, table.where).scope
    if sort not in ("fabric", "muscle type"):
        raise InputError(f"{table.where}: {term.name} belongs to the {sort}; expected it in a model, not in a design")
    known = ["fabric"] if sort == "fabric" else [MUSCLE_TYPES + name for name in types]
    scope = term.scope or (known[0] if len(known) == 1 else None)
    if scope not in known:
        expected = " or ".join(known) or "a muscle type"
        raise InputError(f"{table.where}: scope is {scope or 'missing'}; expected {expected}")
    return replace(term, scope=scope)


def _merged(tables: list[tuple[Path, Table]], scene: dict[str, Any]) -> Table:
    """One fabric table; a key may stand in one place only. Paths become independent of the file that names them."""
    first = tables[-1][1]
    values = dict(scene)
    for origin, table in tables:
        for key in table.names():
            if key in values:
                elsewhere = "at top level" if key in scene else "in an included file"
                one = "; `fabdesign calibrate ACROSS DOWN -o CLOTH.toml` makes one curve of two strips"
                raise InputError(f"{first.where}: {key} stands {elsewhere} too{one if key == 'membrane_curve' else ''}")
            value = table.take(key)
            values[key] = str(origin.parent / value) if key == "membrane_curve" and isinstance(value, str) else value
    return Table(values, first.where)


def _fabric(table: Table) -> Fabric:
    width = table.number("width", above=0)
    height = table.number("height", above=0)
    for key, size in (("width", width), ("height", height)):
        if size > _LARGEST:
            raise table.bad(key, "metres (is it in millimetres?)")
    curve_name = table.text("membrane_curve", None)
    curve = None if curve_name is None else read_membrane_curve(Path(curve_name))
    stiffness = table.pair("membrane_stiffness", None, above=0) or _initial_stiffness(curve, table)
    poisson = table.number("poisson")
    # nu_12 nu_21 = nu_12^2 k_2 / k_1 < 1, or stretching the cloth would give energy
    if poisson**2 * stiffness[1] >= stiffness[0]:
        raise table.bad("poisson", f"nu_12 below sqrt(k_1 / k_2) = {(stiffness[0] / stiffness[1]) ** 0.5:.3g}")
    fabric = Fabric(
        width=width,
        height=height,
        thickness=table.number("thickness", above=0),
        areal_density=table.number("areal_density", above=0),
        membrane_stiffness=stiffness,
        shear_stiffness=table.number("shear_stiffness", above=0),
        poisson=poisson,
        bending_stiffness=table.pair("bending_stiffness", above=0),
        twist_stiffness=table.number("twist_stiffness", None, least=0),
        viscosity=table.number("viscosity", 0.0, least=0),
        air_damping=table.number("air_damping", 0.0, least=0),
        support=table.text("support", "pinned", choices=("pinned", "clamped")),
        hung=_hung(table, width, height),
        gravity=table.numbers("gravity", (0.0, -9.81, 0.0), count=3),
        membrane_curve=curve,
    )
    table.finish()
    return fabric


def _initial_stiffness(curve: MembraneCurve | None, table: Table) -> tuple[float, float]:
    """The slope at small strain of a curve that replaces both stiffnesses."""
    if curve is None or not all(curve.strain):
        raise InputError(f"{table.where}: membrane_stiffness is missing")
    slopes = [(t[1] - t[0]) / (s[1] - s[0]) for s, t in zip(curve.strain, curve.tension, strict=True)]
    return slopes[0], slopes[1]


def _hung(table: Table, width: float, height: float) -> Any:
    if isinstance(table.take("hung", "top"), str):
        return table.text("hung", "top", choices=EDGES)
    points = table.points("hung")
    for i, point in enumerate(points):
        _require_inside(point, width, height, f"{table.where}: hung[{i}]")
    return points


def _muscle_type(name: str, table: Table, path: Path) -> MuscleType:
    kind = MuscleType(
        name=name,
        outer_diameter=table.number("outer_diameter", above=0),
        mass_per_length=table.number("mass_per_length", above=0),
        axis_offset=table.number("axis_offset", least=0),
        bench=read_bench_table(table.path("bench", path.parent)),
        viscosity=table.number("viscosity", 0.0, least=0),
        max_pressure=table.kilopascals("max_pressure", None, above=0),
        stock_length=table.number("stock_length", None, above=0),
        min_bend_radius=table.number("min_bend_radius", None, least=0),
        tail_length=table.number("tail_length", None, least=0),
    )
    table.finish()
    return kind


def _muscle(table: Table, fabric: Fabric, types: dict[str, MuscleType]) -> Muscle:
    kind = table.text("type")
    if kind not in types:
        if not types:
            raise table.bad("type", f"[muscle_types.{kind}] in this file, or in one that it includes")
        raise table.bad("type", f"one of {', '.join(types)}{nearest(kind, [*types])}")
    path = table.points("path")
    if len(path) < 2:
        raise table.bad("path", "at least two [u, v] points")
    for i, point in enumerate(path):
        _require_inside(point, fabric.width, fabric.height, f"{table.where}: path[{i}]")
        if i and point == path[i - 1]:
            raise InputError(f"{table.where}: path[{i}] repeats the point before it")
    muscle = Muscle(
        type=kind,
        side=table.text("side", choices=("front", "back")),
        channel=table.integer("channel", least=0, most=MUSCLES - 1),
        path=path,
        fixed_point_pitch=table.number("fixed_point_pitch", least=CLOSEST),
    )
    if muscle.fixed_point_pitch > _LARGEST:
        raise table.bad("fixed_point_pitch", "metres (is it in millimetres?)")
    table.finish()
    return muscle


def _require_inside(point: tuple[float, float], width: float, height: float, where: str) -> None:
    for axis, value, size in (("u", point[0], width), ("v", point[1], height)):
        if not -_SLACK <= value <= size + _SLACK:
            hint = " (is it in millimetres?)" if value > 20 * size else ""
            raise InputError(f"{where}: {axis} = {value:g} m lies outside the cloth, 0 to {size:g} m{hint}")
