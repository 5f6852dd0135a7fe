"""A fitted model: everything that a prediction needs beyond the design."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign import SIMULATOR
from fabdesign.forward import MUSCLE_TYPES, OF_MUSCLES, SIDE, Term
from fabdesign.learned_range import LearnedRange

POINTS_PER_SIDE = SIDE  # of the simulator's grid, unless something else is asked for
PARTS = ("rig", "sensors", "corrector", "spread")  # what may be left out of a model


@dataclass(frozen=True)
class Parameter:
    """A factor on one declared value (`forward.PARAMETERS`), with its 90 % interval."""

    factor: float
    interval90: tuple[float, float] | None = None  # None: not known
    reliable: bool = True  # False: fitted by a model that left too much for its intervals to hold
    scope: str | None = None  # what it belongs to: "fabric", "muscle_types.NAME", "rig"; None: as the format says


@dataclass(frozen=True)
class Quantity:
    """One parameter of an effect, in the unit that the effect declares."""

    value: float
    unit: str
    interval90: tuple[float, float] | None = None


@dataclass(frozen=True)
class EffectTerm:
    """An effect that the model switches on."""

    name: str
    parameters: Mapping[str, Quantity] = field(default_factory=dict)
    scope: str | None = None  # "fabric", "muscle_types.NAME", "rig" or "sensors"

    @property
    def term(self) -> Term:
        """What `forward.Case` takes."""
        return Term(self.name, {name: quantity.value for name, quantity in self.parameters.items()}, self.scope)


@dataclass(frozen=True, eq=False)
class Covariance:
    """Joint covariance of what was fitted together.

    names: parameters by name (of their factors' logarithms) and effects' parameters as EFFECT.PARAMETER (by their
    declared transform: logarithm or the value itself). matrix (n, n) in their order.
    """

    names: tuple[str, ...]
    matrix: NDArray[np.float64]

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Covariance)
            and self.names == other.names
            and bool(np.array_equal(self.matrix, other.matrix))
        )


@dataclass(frozen=True)
class Spread:
    """Half-widths of 90 % intervals of where a predicted motion lies, along its normal, in quadrature
    (fabdesign/spread.py): calibrated on trials that the model was not fitted to."""

    constant: float  # m
    covariance: float  # on the standard deviation that the model's joint covariance gives
    motion: float  # m for each m moved since rest
    trials: int  # calibrated on
    held: float  # share of their residuals inside, each calibrated on the others
    trained_on: str  # hash of the model that it belongs to (fabdesign.spread)
    designs: Mapping[str, float] = field(default_factory=dict)  # name of one that has enough trials -> times all this


@dataclass(frozen=True)
class Provenance:
    """Where a model comes from. Trials are named SET/TRIAL."""

    sets: tuple[str, ...] = ()
    fitted: tuple[str, ...] = ()
    held_out: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)  # package -> version
    hashes: Mapping[str, str] = field(default_factory=dict)  # file -> sha256 of its content
    seed: int | None = None


@dataclass(frozen=True)
class Model:
    """What was fitted to a specimen: factors on declared values (1 is the data sheet), effects, corrector.

    parameters: by the names in forward.PARAMETERS, a muscle type's own also as "muscle_types.NAME.PARAMETER".
    without_effects: the factors fitted when no effect and no corrector was there.
    Limits: factors belong to the grid they were found on (`points_per_side`). fabdesign.model_file reads and writes it.

    >>> Model({"bending": Parameter(1.2, (1.1, 1.3))}).factors
    {'bending': 1.2}
    """

    parameters: Mapping[str, Parameter] = field(default_factory=dict)  # what is absent stays as declared
    effects: tuple[EffectTerm, ...] = ()
    corrector: Path | None = None  # safetensors
    points_per_side: int = POINTS_PER_SIDE  # of the simulator's grid that the factors were found on and belong to
    provenance: Provenance = Provenance()
    without_effects: Mapping[str, Parameter] | None = None
    covariance: Covariance | None = None
    corrector_hash: str | None = None  # of the parameters and effects that it was trained on (fabdesign.corrector)
    spread: Spread | None = None  # None: its motions have no intervals
    learned_range: LearnedRange | None = None  # of what was fitted without a physical name; None: nothing, or not known

    @property
    def factors(self) -> dict[str, float]:
        """What `forward.Case` takes: a muscle type's own by that type's name."""
        return {_own_name(name, parameter): parameter.factor for name, parameter in self.parameters.items()}

    @property
    def unreliable(self) -> tuple[str, ...]:
        """Return the parameters whose intervals the fit calls not reliable."""
        return tuple(name for name, parameter in self.parameters.items() if not parameter.reliable)

    @property
    def terms(self) -> tuple[Term, ...]:
        """What `forward.Case` takes."""
        return tuple(effect.term for effect in self.effects)

    @property
    def before(self) -> "Model":
        """What `evaluate` calls before: no effects and no corrector, with the factors fitted without them; the data
        sheet of a model that has neither."""
        if not self.effects and self.corrector is None:
            return Model(points_per_side=self.points_per_side)
        plain = self.parameters if self.without_effects is None else self.without_effects
        return replace(
            self,
            parameters=plain,
            effects=(),
            corrector=None,
            corrector_hash=None,
            without_effects=None,
            covariance=None,
            spread=None,
            learned_range=None,
        )

    def without(self, parts: Collection[str]) -> "Model":
        """The model less what belongs to `parts`, of PARTS. A spread is the whole model's: it goes with any of them."""
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
        """Why its factors may not fit this simulator, in a line; None where nothing speaks against them."""
        made = self.provenance.versions.get("simulator")
        if not self.provenance.versions or made == SIMULATOR:
            return None
        return f"the model was made by version {made or 1} of the simulator, this one is {SIMULATOR}; calibrate again"


def _own_name(name: str, parameter: Parameter) -> str:
    scope = parameter.scope or ""
    return f"{scope}.{name}" if name in OF_MUSCLES and scope.startswith(MUSCLE_TYPES) else name
