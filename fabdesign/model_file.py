"""Model files: `fabdesign.model/1`."""

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from fabdesign.corrector import central_hash
from fabdesign.effect_file import effect_items, read_effect, read_interval, read_scope
from fabdesign.effects.registry import label_effect, labels_of
from fabdesign.effort import COARSEST, FINEST
from fabdesign.errors import InputError
from fabdesign.forward import FACTOR_RANGE, MUSCLE_TYPES, OF_MUSCLES, PARAMETERS
from fabdesign.learned_range import LearnedRange
from fabdesign.model import PARTS, POINTS_PER_SIDE, Covariance, Model, Parameter, Provenance, Spread
from fabdesign.output import write_text
from fabdesign.spread import spread_of
from fabdesign.table import Table, load_toml, nearest
from fabdesign.units import kilopascals

FORMAT = "fabdesign.model/1"


def read_model(path: Path | str) -> Model:
    """Read a model: its file, or a folder with `model.toml`. Raises InputError."""
    path = Path(path)
    if path.is_dir():
        path = path / "model.toml"
    root = load_toml(path, FORMAT)
    parameters = _parameters(root, "parameters") or {}
    without_effects = _parameters(root, "parameters_without_effects")
    effects = tuple(read_effect(table) for table in root.tables("effects"))
    terms = [effect.term for effect in effects]
    labels = [(label, term.scope) for label, term in zip(labels_of(terms), terms, strict=True)]
    if twice := next((label for label, scope in labels if labels.count((label, scope)) > 1), None):
        raise InputError(f"{path}: effects: {label_effect(twice)} stands twice with one scope; expected it once")
    corrector, corrector_hash = None, None
    if (weights := root.table("corrector", None)) is not None:
        corrector = weights.path("weights", path.parent)
        corrector_hash = weights.text("trained_on", None)
        weights.finish()
        if not corrector.is_file():
            raise InputError(f"{path}: corrector: weights {corrector} is not there")
    points_per_side = POINTS_PER_SIDE
    if (simulator := root.table("simulator", None)) is not None:
        points_per_side = simulator.integer("points_per_side", least=COARSEST, most=FINEST)
        simulator.finish()
    provenance = root.table("provenance", None)
    origin = Provenance() if provenance is None else _provenance(provenance)
    covariance = _covariance(root.table("covariance")) if "covariance" in root else None
    spread = _spread(root.table("spread")) if "spread" in root else None
    learned = _learned_range(root.table("learned_range")) if "learned_range" in root else None
    model = Model(
        parameters,
        effects,
        corrector,
        points_per_side,
        origin,
        without_effects,
        covariance,
        corrector_hash,
        spread,
        learned,
    )
    root.finish()
    if corrector_hash not in (None, central_hash(model)):
        raise InputError(
            f"{path}: corrector: trained on other parameters or effects than the file has now; expected those it was "
            "trained on (train again, or take [corrector] out)"
        )
    return model


def write_model(model: Model, path: Path | str) -> None:
    """Write a model; reading it gives an equal one. The corrector's weights must lie there already; their path is
    stored relative to the file. Raises InputError where `path` cannot be written."""
    path = Path(path)
    document = tomlkit.document()
    document["format"] = FORMAT
    document["parameters"] = {name: _parameter_items(parameter) for name, parameter in model.parameters.items()}
    if model.without_effects is not None:
        document["parameters_without_effects"] = {
            name: _parameter_items(parameter) for name, parameter in model.without_effects.items()
        }
    if model.effects:
        document["effects"] = [effect_items(effect) for effect in model.effects]
    if model.covariance is not None:
        rows = [[float(x) for x in row] for row in model.covariance.matrix]
        document["covariance"] = {"names": list(model.covariance.names), "matrix": rows}
    if model.corrector is not None:
        trained_on = {} if model.corrector_hash is None else {"trained_on": model.corrector_hash}
        weights = Path(os.path.relpath(model.corrector, path.parent)).as_posix()
        document["corrector"] = {"weights": weights} | trained_on
    if model.spread is not None:
        document["spread"] = asdict(model.spread)
    if (learned := model.learned_range) is not None:
        in_kpa = {"pressure": kilopascals(learned.pressure), "rate": kilopascals(learned.rate)}
        numbers = {name: tomlkit.value(f"{number.normalize():f}") for name, number in in_kpa.items()}
        document["learned_range"] = {**numbers, "channels": learned.channels}
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
    if not parameter.reliable:
        items["believable"] = False
    if parameter.scope is not None:
        items["scope"] = parameter.scope
    return items


def _parameter(table: Table) -> Parameter:
    factor = table.number("factor", least=FACTOR_RANGE[0], most=FACTOR_RANGE[1])
    interval = read_interval(table, "interval90") if "interval90" in table else None
    parameter = Parameter(factor, interval, table.flag("believable", True), read_scope(table))
    table.finish()
    return parameter


def _parameters(root: Table, key: str) -> dict[str, Parameter] | None:
    if (table := root.table(key, None)) is None:
        return None
    parameters = {}
    for name in table.names():
        plain = name.rpartition(".")[2] if name.startswith(MUSCLE_TYPES) else name
        if plain not in PARAMETERS or (plain != name and plain not in OF_MUSCLES):
            raise InputError(
                f"{table.where}: unknown parameter {name}; "
                f"expected one of {', '.join(PARAMETERS)}{nearest(name, PARAMETERS)}"
            )
        parameters[name] = _parameter(table.table(name))
    return parameters


def _covariance(table: Table) -> Covariance:
    names = table.texts("names")
    rows = table.take("matrix")
    try:
        matrix = np.array([[float(x) for x in row] for row in rows])
    except (TypeError, ValueError):
        raise table.bad("matrix", "rows of numbers") from None
    if matrix.shape != (len(names), len(names)) or not np.isfinite(matrix).all():
        raise table.bad("matrix", f"{len(names)} rows of {len(names)} finite numbers, as many as names")
    if not np.allclose(matrix, matrix.T) or np.linalg.eigvalsh(matrix).min(initial=0.0) < -1e-9 * np.abs(matrix).max():
        raise table.bad("matrix", "a covariance: symmetric, no negative eigenvalue")
    table.finish()
    return Covariance(tuple(names), matrix)


def _spread(table: Table) -> Spread:
    designs = table.table("designs", Table({}, table.where))
    spread = Spread(
        constant=table.number("constant", least=0),
        covariance=table.number("covariance", least=0),
        motion=table.number("motion", least=0),
        trials=table.integer("trials", least=1),
        held=table.number("held", least=0, most=1),
        trained_on=table.text("trained_on"),
        designs={name: designs.number(name, least=0) for name in designs.names()},
    )
    designs.finish()
    table.finish()
    return spread


def _learned_range(table: Table) -> LearnedRange:
    for name in ("pressure", "rate"):
        table.number(name, least=0)
    learned = LearnedRange(
        pressure=table.kilopascals("pressure"),
        rate=table.kilopascals("rate"),
        channels=table.integer("channels", least=0),
    )
    table.finish()
    return learned


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


def usable_model(
    model: Model | Path | str, without: Sequence[str] = (), *, say: Callable[[str], None] = lambda line: None
) -> Model:
    """The model, or that of a file, less the parts named (fabdesign.model.PARTS).

    `say` hears a line where it was made by another version of the simulator, and on what was left out. Raises
    InputError.
    """
    name = "model" if isinstance(model, Model) else str(model)
    read = model if isinstance(model, Model) else read_model(model)
    if read.stale is not None:
        say(f"{name}: {read.stale}")
    if read.spread is not None and spread_of(read) is None:
        say(f"{name}: the model was changed since its intervals were calibrated; its motions have none")
    if not without:
        return read
    parts: list[Any] = [part.strip() for part in without]
    for part in parts:
        if part not in PARTS:
            raise InputError(f"--without {part}: expected one of {', '.join(PARTS)}{nearest(part, PARTS)}")
    less = read.without(parts)
    gone = [*(e.name for e in read.effects if e not in less.effects)]
    gone += [parameter for parameter in read.parameters if parameter not in less.parameters]
    gone += ["corrector"] if read.corrector is not None and less.corrector is None else []
    gone += ["spread"] if read.spread is not None and less.spread is None else []
    say(f"{name}: without {', '.join(parts)}: {', '.join(gone) or 'nothing'} left out")
    return less
