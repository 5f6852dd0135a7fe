"""Model files: `fabdesign.model/1`."""

import os
from pathlib import Path
from typing import Any

import tomlkit

from fabdesign.effort import COARSEST, FINEST
from fabdesign.errors import InputError
from fabdesign.forward import FACTORS, PARAMETERS
from fabdesign.model import POINTS_PER_SIDE, EffectTerm, Model, Parameter, Provenance, Quantity
from fabdesign.output import write_text
from fabdesign.table import Table, load_toml, nearest

FORMAT = "fabdesign.model/1"


def read_model(path: Path | str) -> Model:
    """Read a model: its file, or a folder with `model.toml`. Raises InputError."""
    path = Path(path)
    if path.is_dir():
        path = path / "model.toml"
    root = load_toml(path, FORMAT)
    parameters = {}
    if (table := root.table("parameters", None)) is not None:
        for name in table.names():
            if name not in PARAMETERS:
                raise InputError(
                    f"{table.where}: unknown parameter {name}; "
                    f"expected one of {', '.join(PARAMETERS)}{nearest(name, PARAMETERS)}"
                )
            parameters[name] = _parameter(table.table(name))
    effects = tuple(_effect(table) for table in root.tables("effects"))
    corrector = None
    if (weights := root.table("corrector", None)) is not None:
        corrector = path.parent / weights.text("weights")
        weights.finish()
        if not corrector.is_file():
            raise InputError(f"{path}: corrector: weights {corrector} is not there")
    points_per_side = POINTS_PER_SIDE
    if (simulator := root.table("simulator", None)) is not None:
        points_per_side = simulator.integer("points_per_side", least=COARSEST, most=FINEST)
        simulator.finish()
    provenance = root.table("provenance", None)
    origin = Provenance() if provenance is None else _provenance(provenance)
    model = Model(parameters, effects, corrector, points_per_side, origin)
    root.finish()
    return model


def write_model(model: Model, path: Path | str) -> None:
    """Write a model; reading it gives an equal one. The corrector's weights must lie there already; their path is
    stored relative to the file. Raises InputError where `path` cannot be written."""
    path = Path(path)
    document = tomlkit.document()
    document["format"] = FORMAT
    document["parameters"] = {name: _parameter_items(parameter) for name, parameter in model.parameters.items()}
    if model.effects:
        document["effects"] = [
            {"name": effect.name, "parameters": {name: _quantity_items(q) for name, q in effect.parameters.items()}}
            for effect in model.effects
        ]
    if model.corrector is not None:
        document["corrector"] = {"weights": Path(os.path.relpath(model.corrector, path.parent)).as_posix()}
    document["simulator"] = {"points_per_side": model.points_per_side}
    origin = model.provenance
    items: dict[str, Any] = {
        "sets": list(origin.sets),
        "fitted": list(origin.fitted),
        "held_out": list(origin.held_out),
        "versions": dict(origin.versions),
        "hashes": dict(origin.hashes),
    }
    if origin.seed is not None:
        items["seed"] = origin.seed
    document["provenance"] = items
    write_text(path, tomlkit.dumps(document))


def _parameter_items(parameter: Parameter) -> dict[str, Any]:
    items: dict[str, Any] = {"factor": float(parameter.factor)}
    if parameter.interval90 is not None:
        items["interval90"] = [float(x) for x in parameter.interval90]
    if not parameter.believable:
        items["believable"] = False
    return items


def _quantity_items(quantity: Quantity) -> dict[str, Any]:
    items: dict[str, Any] = {"value": float(quantity.value), "unit": quantity.unit}
    if quantity.interval95 is not None:
        items["interval95"] = [float(x) for x in quantity.interval95]
    return items


def _parameter(table: Table) -> Parameter:
    factor = table.number("factor", least=FACTORS[0], most=FACTORS[1])
    interval = _interval(table, "interval90") if "interval90" in table else None
    parameter = Parameter(factor, interval, table.flag("believable", True))
    table.finish()
    return parameter


def _interval(table: Table, key: str) -> tuple[float, float]:
    low, high = table.numbers(key, count=2)
    if low > high:
        raise table.bad(key, "[low, high]")
    return low, high


def _effect(table: Table) -> EffectTerm:
    name = table.text("name")
    parameters = {}
    if (values := table.table("parameters", None)) is not None:
        for key in values.names():
            item = values.table(key)
            interval = _interval(item, "interval95") if "interval95" in item else None
            item.take("interval95", None)
            parameters[key] = Quantity(item.number("value"), item.text("unit"), interval)
            item.finish()
    table.finish()
    return EffectTerm(name, parameters)


def _provenance(table: Table) -> Provenance:
    provenance = Provenance(
        sets=table.texts("sets", ()),
        fitted=table.texts("fitted", ()),
        held_out=table.texts("held_out", ()),
        versions=_texts(table, "versions"),
        hashes=_texts(table, "hashes"),
        seed=table.integer("seed", None),
    )
    table.finish()
    return provenance


def _texts(table: Table, key: str) -> dict[str, str]:
    inner = table.table(key, None)
    return {} if inner is None else {name: inner.text(name) for name in inner.names()}
