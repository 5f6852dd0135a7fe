"""`[[effects]]` in files: of a model, and of a muscle type or a cloth that was on a bench."""

from collections.abc import Iterable
from typing import Any

from fabdesign.effects.registry import check_values, effect_named
from fabdesign.model import EffectTerm, Quantity
from fabdesign.table import Table, nearest
from fabdesign.term import MUSCLE_TYPES

SCOPES = ("fabric", "rig", "sensors")
_OF_95 = 1.645 / 1.960  # a 90 % interval over a 95 % one


def read_effect(table: Table) -> EffectTerm:
    """One table of [[effects]]. Raises InputError for an unknown effect, parameter or scope, another unit, and a value
    beyond its bounds."""
    effect = effect_named(table.text("name"), table.where)
    parameters: dict[str, Quantity] = {}
    if (values := table.table("parameters", None)) is not None:
        for key in values.names():
            item = values.table(key)
            value, unit = item.number("value"), item.text("unit")
            check_values(effect, {key: value}, item.where)
            if unit != (declared := effect.parameters[key].unit):
                raise item.bad("unit", f'"{declared}"')
            parameters[key] = Quantity(value, unit, _interval_of(item, value))
            item.finish()
    term = EffectTerm(effect.name, parameters, read_scope(table))
    table.finish()
    return term


def effect_items(effect: EffectTerm) -> dict[str, Any]:
    """The same as it is written."""
    items: dict[str, Any] = {"name": effect.name}
    if effect.scope is not None:
        items["scope"] = effect.scope
    return items | {"parameters": {name: _quantity_items(q) for name, q in effect.parameters.items()}}


def read_scope(table: Table, known: Iterable[str] = SCOPES) -> str | None:
    """What a parameter or an effect belongs to. Raises InputError."""
    scope: str | None = table.text("scope", None)
    if scope is not None and scope not in known and not scope.startswith(MUSCLE_TYPES):
        raise table.bad("scope", f"one of {', '.join(known)}, {MUSCLE_TYPES}NAME{nearest(scope, [*known])}")
    return scope


def read_interval(table: Table, key: str) -> tuple[float, float]:
    low, high = table.numbers(key, count=2)
    if low > high:
        raise table.bad(key, "[low, high]")
    return low, high


def _interval_of(table: Table, value: float) -> tuple[float, float] | None:
    """The 90 % interval; of a file with 95 %, that of the same normal distribution."""
    if "interval90" in table:
        return read_interval(table, "interval90")
    if "interval95" not in table:
        return None
    low, high = read_interval(table, "interval95")
    return value + _OF_95 * (low - value), value + _OF_95 * (high - value)


def _quantity_items(quantity: Quantity) -> dict[str, Any]:
    items: dict[str, Any] = {"value": float(quantity.value), "unit": quantity.unit}
    if quantity.interval90 is not None:
        items["interval90"] = [float(x) for x in quantity.interval90]
    return items
