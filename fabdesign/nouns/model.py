"""A fitted model: everything that a prediction needs beyond the design."""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import NormalDist
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.registry import check_values, effect_named, label_effect, labels_of
from fabdesign.formats.schema import FROM_0, GRIDS, SHARE, Key, Metre, Within
from fabdesign.formats.table import Table, nearest
from fabdesign.nouns.forward import FACTOR_RANGE, MUSCLE_TYPES, OF_MUSCLES, PARAMETERS, SIDE, Term
from fabdesign.nouns.pressure import LearnedRange
from fabdesign.runtime.fingerprint import sha256
from fabdesign.version import SIMULATOR

POINTS_PER_SIDE = SIDE  # of the simulator's grid, unless something else is asked for
SCOPES = ("fabric", "rig", "sensors")
PARTS = ("rig", "sensors", "corrector", "spread")  # what may be left out of a model


INSIDE = 0.9  # of what an interval is of
NORMAL90 = NormalDist().inv_cdf(0.5 + INSIDE / 2)  # standard deviations to either side that hold 90 % of a normal one
_OF_95 = NORMAL90 / NormalDist().inv_cdf(0.975)  # a 90 % interval over a 95 % one


def _interval(value: tuple[float, float], table: Table) -> tuple[float, float] | None:
    return value if value[0] <= value[1] else None


def _of_95(value: tuple[float, float], table: Table) -> tuple[float, float] | None:
    """Return the 90 % interval of the normal distribution whose 95 % one is given."""
    middle: float = table.find("value") or 0.0
    low, high = (middle + _OF_95 * (end - middle) for end in value)
    return _interval((low, high), table)


def _scope(value: str, table: Table) -> str:
    if value not in SCOPES and not value.startswith(MUSCLE_TYPES):
        raise table.bad("scope", f"one of {', '.join(SCOPES)}, {MUSCLE_TYPES}NAME{nearest(value, SCOPES)}")
    return value


_ENDS = Key(form=tuple[float, float], read=_interval, expected="[low, high]")
Interval = Annotated[tuple[float, float], _ENDS]
Scope = Annotated[
    str | None, Key(form=str, read=_scope), "fabric, muscle_types.NAME, rig or sensors; absent: as names say"
]


Times = Annotated[float, FROM_0]
_INTERVALS = Key(
    one_of={
        "interval90": Annotated[Interval, "absent: not known"],
        "interval95": Annotated[tuple[float, float], replace(_ENDS, read=_of_95), "of old files"],
    },
    expected="interval90 alone",
)
_RELIABLE = Key(also="believable", brief=True)
_BEFORE, _GRID = Key("parameters_without_effects"), Key("simulator.points_per_side")


@dataclass(frozen=True)
class Parameter:
    """A factor on one declared value (`forward.PARAMETERS`), with its 90 % interval."""

    factor: Annotated[float, Within(least=FACTOR_RANGE[0], most=FACTOR_RANGE[1]), "on the declared value"]
    interval90: Annotated[Interval | None, "absent: not known"] = None
    reliable: Annotated[bool, _RELIABLE, "false: the fit left too much for its intervals to hold"] = True
    scope: Scope = None


@dataclass(frozen=True)
class Quantity:
    """One parameter of an effect, in the unit that the effect declares."""

    value: float
    unit: Annotated[str, "the declared one"]
    interval90: Annotated[tuple[float, float] | None, _INTERVALS] = None


@dataclass(frozen=True)
class EffectTerm:
    """An effect that the model switches on."""

    name: Annotated[str, "one of `fabdesign effects`"]
    parameters: Annotated[Mapping[str, Quantity], "what is absent has its default"] = field(default_factory=dict)
    scope: Scope = None

    def resolved(self, table: Table) -> "EffectTerm":
        """Raise InputError for an unknown effect or parameter, another unit, and a value beyond its bounds."""
        effect = effect_named(self.name, table.where)
        for name, quantity in self.parameters.items():
            where = table.within(["parameters"]).inner(name)
            check_values(effect, {name: quantity.value}, where.where)
            if quantity.unit != (declared := effect.parameters[name].unit):
                raise where.bad("unit", f'"{declared}"')
        return self

    @property
    def term(self) -> Term:
        """Return what `forward.Case` takes."""
        return Term(self.name, {name: quantity.value for name, quantity in self.parameters.items()}, self.scope)


def _rows(value: Any, table: Table) -> NDArray[np.float64] | None:
    try:
        return np.array([[float(x) for x in row] for row in value])
    except (TypeError, ValueError):
        return None


@dataclass(frozen=True, eq=False)
class Covariance:
    """Joint covariance of what was fitted together.

    names: parameters by name (of their factors' logarithms) and effects' parameters as EFFECT.PARAMETER (by their
    declared transform: logarithm or the value itself). matrix (n, n) in their order.
    """

    names: Annotated[tuple[str, ...], "of parameters, and effects' as EFFECT.PARAMETER"]
    matrix: Annotated[NDArray[np.float64], Key(read=_rows, expected="rows of numbers"), "joint"]

    def resolved(self, table: Table) -> "Covariance":
        """Raise InputError for a matrix that is no covariance of the names."""
        count = len(self.names)
        if self.matrix.shape != (count, count) or not np.isfinite(self.matrix).all():
            raise table.bad("matrix", f"{count} rows of {count} finite numbers, as many as names")
        least = np.linalg.eigvalsh(self.matrix).min(initial=0.0)
        if not np.allclose(self.matrix, self.matrix.T) or least < -1e-9 * np.abs(self.matrix).max():
            raise table.bad("matrix", "a covariance: symmetric, no negative eigenvalue")
        return self

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Covariance)
            and self.names == other.names
            and bool(np.array_equal(self.matrix, other.matrix))
        )


@dataclass(frozen=True)
class Spread:
    """Half-widths of 90 % intervals of where a predicted motion lies, along its normal, in quadrature
    (fabdesign/nouns/model_sampling.py): calibrated on trials that the model was not fitted to."""

    constant: Annotated[Metre, FROM_0, "half-width"]
    covariance: Annotated[float, FROM_0, "on the standard deviation that [covariance] gives"]
    motion: Annotated[float, FROM_0, "m for each m moved since rest"]
    trials: Annotated[int, Within(least=1), "calibrated on"]
    held: Annotated[float, SHARE, "share of their residuals inside, each calibrated on the others"]
    trained_on: Annotated[
        str, "hash of parameters, effects, covariance and corrector"
    ]  # fabdesign.nouns.model_sampling
    designs: Annotated[Mapping[str, Times], "times all of this, of designs by name"] = field(default_factory=dict)
    json_keys: ClassVar = ("constant_mm", "constant"), "covariance", "motion", "trials", "held", "designs"


@dataclass(frozen=True)
class Provenance:
    """Where a model comes from. Trials are named SET/TRIAL."""

    sets: Annotated[tuple[str, ...], "measured"] = ()
    fitted: Annotated[tuple[str, ...], "trials"] = ()
    held_out: Annotated[tuple[str, ...], "trials"] = ()
    versions: Annotated[Mapping[str, str], "package = version"] = field(default_factory=dict)
    hashes: Annotated[Mapping[str, str], "file = SHA-256 of its content"] = field(default_factory=dict)
    seed: int | None = None


ORIGIN_UNKNOWN = Provenance()


@dataclass(frozen=True)
class Model:
    """A model fitted to a specimen: factors on declared values (1 is the data sheet), effects, corrector.

    parameters: by the names in forward.PARAMETERS, a muscle type's own also as "muscle_types.NAME.PARAMETER".
    without_effects: the factors fitted when no effect and no corrector was there.
    Limits: factors belong to the grid they were found on (`points_per_side`). files.model_file reads and writes it.

    >>> Model({"bending": Parameter(1.2, (1.1, 1.3))}).factors
    {'bending': 1.2}
    """

    parameters: Annotated[Mapping[str, Parameter], "what is absent stays as declared"] = field(default_factory=dict)
    effects: Annotated[tuple[EffectTerm, ...], Key(brief=True), "in the order in which they act"] = ()
    without_effects: Annotated[Mapping[str, Parameter] | None, _BEFORE, "fitted when no effect was there"] = None
    covariance: Annotated[Covariance | None, "of what was fitted together"] = None
    corrector: Annotated[Path | None, Key("corrector.weights", there=Path.is_file), "safetensors"] = None
    corrector_hash: Annotated[str | None, Key("corrector.trained_on"), "hash of parameters and effects"] = None
    spread: Annotated[Spread | None, "absent: its motions have no intervals"] = None
    learned_range: Annotated[LearnedRange | None, "of what has no physical name; absent: not known"] = None
    points_per_side: Annotated[int, _GRID, GRIDS, "of the grid that the factors belong to"] = POINTS_PER_SIDE
    provenance: Provenance = ORIGIN_UNKNOWN

    def resolved(self, table: Table) -> "Model":
        """Raise InputError for unknown parameters, an effect that stands twice, and no weights."""
        for key in ("parameters", "parameters_without_effects"):
            for name in table.within([key]).names():
                plain = name.rpartition(".")[2] if name.startswith(MUSCLE_TYPES) else name
                if plain not in PARAMETERS or (plain != name and plain not in OF_MUSCLES):
                    expected = f"expected one of {', '.join(PARAMETERS)}{nearest(name, PARAMETERS)}"
                    raise table.within([key]).error(f"unknown parameter {name}; {expected}")
        labels = [(label, term.scope) for label, term in zip(labels_of(self.terms), self.terms, strict=True)]
        if twice := next((label for label, scope in labels if labels.count((label, scope)) > 1), None):
            raise table.error(f"effects: {label_effect(twice)} stands twice with one scope; expected it once")
        if "corrector" in table and self.corrector is None:
            raise table.within(["corrector"]).missing("weights")
        return self

    @property
    def factors(self) -> dict[str, float]:
        """Return the factors that `forward.Case` takes: a muscle type's own by that type's name."""
        factors = {}
        for name, parameter in self.parameters.items():
            of_a_type = name in OF_MUSCLES and (parameter.scope or "").startswith(MUSCLE_TYPES)
            factors[f"{parameter.scope}.{name}" if of_a_type else name] = parameter.factor
        return factors

    @property
    def unreliable(self) -> tuple[str, ...]:
        """Return the parameters whose intervals the fit calls not reliable."""
        return tuple(name for name, parameter in self.parameters.items() if not parameter.reliable)

    @property
    def terms(self) -> tuple[Term, ...]:
        """Return what `forward.Case` takes."""
        return tuple(effect.term for effect in self.effects)

    @property
    def central_hash(self) -> str:
        """Return the SHA-256 of the central values of parameters and effects; intervals and provenance do not count."""
        central = {
            "parameters": {name: repr(float(p.factor)) for name, p in sorted(self.parameters.items())},
            "effects": [
                [effect.name, {name: repr(float(q.value)) for name, q in sorted(effect.parameters.items())}]
                for effect in self.effects
            ],
        }
        return sha256(json.dumps(central, sort_keys=True))

    @property
    def before(self) -> "Model":
        """Return the model that `evaluate` calls before: no effects and no corrector, with the factors fitted without
        them; the data sheet of a model that has neither."""
        if not self.effects and self.corrector is None:
            return Model(points_per_side=self.points_per_side)
        plain = self.parameters if self.without_effects is None else self.without_effects
        return Model(plain, points_per_side=self.points_per_side, provenance=self.provenance)

    def without(self, parts: Collection[str]) -> "Model":
        """Return the model less what belongs to `parts`, of PARTS. A spread is the whole model's: it goes with any of
        them."""
        less = replace(
            self,
            parameters={k: p for k, p in self.parameters.items() if p.scope not in parts},
            effects=tuple(effect for effect in self.effects if effect.scope not in parts),
            corrector=None if "corrector" in parts else self.corrector,
            corrector_hash=None if "corrector" in parts else self.corrector_hash,
        )
        return less if less == self and "spread" not in parts else replace(less, spread=None)

    @property
    def stale(self) -> str | None:
        """Return why its factors may not fit this simulator, in a line; None where nothing speaks against them."""
        made = self.provenance.versions.get("simulator")
        if not self.provenance.versions or made == SIMULATOR:
            return None
        return f"the model was made by version {made or 1} of the simulator, this one is {SIMULATOR}; calibrate again"
