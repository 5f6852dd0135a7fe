"""A fitted model: everything that a prediction needs beyond the design."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fabdesign.forward import SIDE


@dataclass(frozen=True)
class Parameter:
    """A factor on one declared value (`forward.PARAMETERS`), with its 90 % interval."""

    factor: float
    interval90: tuple[float, float] | None = None  # None: not known
    believable: bool = True  # False: fitted by a model that left too much for its intervals to hold


@dataclass(frozen=True)
class Quantity:
    """One parameter of an effect."""

    value: float
    unit: str
    interval95: tuple[float, float] | None = None


@dataclass(frozen=True)
class EffectTerm:
    """An effect that the model switches on."""

    name: str
    parameters: Mapping[str, Quantity] = field(default_factory=dict)


@dataclass(frozen=True)
class Provenance:
    """Where a model comes from. Trials are named SET/TRIAL."""

    sets: tuple[str, ...] = ()
    fitted: tuple[str, ...] = ()
    held_out: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)  # package -> version
    hashes: Mapping[str, str] = field(default_factory=dict)  # file -> sha256 of its content
    seed: int | None = None


POINTS_PER_SIDE = SIDE  # of the simulator's grid, unless something else is asked for


@dataclass(frozen=True)
class Model:
    """What was fitted to a specimen: factors on declared values (1 is the data sheet), effects, corrector.

    Limits: factors belong to the grid they were found on (`points_per_side`). fabdesign.model_file reads and writes it.

    >>> Model({"bending": Parameter(1.2, (1.1, 1.3))}).factors
    {'bending': 1.2}
    """

    parameters: Mapping[str, Parameter] = field(default_factory=dict)  # what is absent stays as declared
    effects: tuple[EffectTerm, ...] = ()
    corrector: Path | None = None  # safetensors
    points_per_side: int = POINTS_PER_SIDE  # of the simulator's grid that the factors were found on and belong to
    provenance: Provenance = Provenance()

    @property
    def factors(self) -> dict[str, float]:
        """What `forward.Case` takes."""
        return {name: parameter.factor for name, parameter in self.parameters.items()}
