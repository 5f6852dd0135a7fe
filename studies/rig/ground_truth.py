"""The ground truth of a virtual specimen: `fabdesign.key/1`. It is never written into a set."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from fabdesign.design import Design
from fabdesign.effects.registry import effect_named
from fabdesign.errors import InputError
from fabdesign.forward import FACTOR_RANGE, PARAMETERS
from fabdesign.table import Table, load_toml, nearest
from studies.rig.effects import EFFECTS

FORMAT = "fabdesign.key/1"


@dataclass(frozen=True)
class Sensing:
    """The point sensor of a measurement set."""

    frame_rate: float = 30.0  # Hz
    points: int = 1500  # a frame, both faces
    noise: float = 0.0006  # m, an axis
    strays: float = 0.003  # share of points that are not on the cloth


@dataclass(frozen=True)
class EffectSetting:
    """An effect that is on; its parameters in the units that the effect declares."""

    name: str
    parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class GroundTruth:
    """Seed, true parameter factors (names of fabdesign.forward.PARAMETERS), effects and sensing."""

    seed: int = 0
    parameters: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[EffectSetting, ...] = ()
    sensing: Sensing = Sensing()


def with_effects_of(design: Design, truth: GroundTruth) -> GroundTruth:
    """Return the ground truth with the effects of the design's benches, where it does not set the same effect itself.

    Raises InputError for one that the rig does not have, or that belongs to one of several muscle types.
    """
    types = {f"muscle_types.{muscle.type}" for muscle in design.muscles}
    settings = []
    for term in design.effects:
        absent = term.scope not in (None, "fabric", *types)  # of a muscle type that has no muscle here
        if absent or any(setting.name == term.name for setting in truth.effects):
            continue
        where = f"design {design.name}: effect {term.name}"
        declared = effect_named(term.name, where).parameters
        values = {name: term.values.get(name, parameter.typical) for name, parameter in declared.items()}
        known = EFFECTS[term.name].parameters if term.name in EFFECTS else {}
        if not known or any(value for name, value in values.items() if name not in known):
            raise InputError(f"{where}: the virtual rig does not have it; expected a design without it")
        if term.scope in types and len(types) > 1:
            raise InputError(f"{where}: belongs to {term.scope}; expected all muscles of one type, on the rig")
        settings.append(EffectSetting(term.name, {name: values[name] for name in known}))
    return replace(truth, effects=(*settings, *truth.effects))


def read_ground_truth(path: Path | str) -> GroundTruth:
    """Read a ground truth file. Raises InputError."""
    root = load_toml(Path(path), FORMAT)
    seed = root.integer("seed", 0, least=0)
    factors = {}
    if (table := root.table("parameters", None)) is not None:
        for name in table.names():
            if name not in PARAMETERS:
                raise InputError(f"{table.where}: unknown parameter {name}{nearest(name, PARAMETERS)}")
            factors[name] = _factor(table, name)
    effects = tuple(_effect(table) for table in root.tables("effects"))
    sensing = Sensing()
    if (table := root.table("sensing", None)) is not None:
        sensing = Sensing(
            table.number("frame_rate", sensing.frame_rate, above=0, most=1000.0),
            table.integer("points", sensing.points, least=1, most=100_000),
            table.number("noise_m", sensing.noise, least=0, most=0.1),
            table.number("strays", sensing.strays, least=0, most=0.5),
        )
        table.finish()
    root.finish()
    return GroundTruth(seed, factors, effects, sensing)


def _factor(table: Table, name: str) -> float:
    """NAME = 1.1, or a table with `factor` as in a model file."""
    if not isinstance(table.take(name), dict):
        return float(table.number(name, least=FACTOR_RANGE[0], most=FACTOR_RANGE[1]))
    inner = table.table(name)
    for key in ("interval90", "believable"):
        inner.take(key, None)
    factor = float(inner.number("factor", least=FACTOR_RANGE[0], most=FACTOR_RANGE[1]))
    inner.finish()
    return factor


def _effect(table: Table) -> EffectSetting:
    name = table.text("name")
    if name not in EFFECTS:
        raise InputError(
            f"{table.where}: unknown effect {name}{nearest(name, [*EFFECTS])}; known: {', '.join(EFFECTS)}"
        )
    declared = EFFECTS[name].parameters
    values = {}
    if (given := table.table("parameters", None)) is not None:
        for parameter in given.names():
            if parameter not in declared:
                known = ", ".join(f"{p} [{unit}]" for p, (_, unit) in declared.items())
                raise InputError(f"{given.where}: {name} has no parameter {parameter}; it has {known}")
            values[parameter] = _quantity(given, parameter, declared[parameter][1])
    table.finish()
    return EffectSetting(name, values)


def _quantity(table: Table, name: str, unit: str) -> float:
    """NAME = 0.1 in the declared unit, or { value = 0.1, unit = "s" } in that unit."""
    if not isinstance(table.take(name), dict):
        return float(table.number(name))
    inner = table.table(name)
    value = float(inner.number("value"))
    if inner.text("unit", unit) != unit:
        raise inner.bad("unit", f'"{unit}"')
    inner.finish()
    return value
