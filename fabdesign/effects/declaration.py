"""An effect: a physical part that a plain model lacks, declared with its parameters and what it changes.

An effect acts at one or more of four seams: the pressure that acts, constants and geometry of the specimen, forces with
memory (in the kernels, sim/forces/added.py), and what is observed. Where its strength has the value `off`, the model
is the one without it, and the derivative by the strength exists there.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from fabdesign.formats.schema import Key
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.pressure import PressureProgram

_RATE_WINDOW = 3  # rows on either side of the one whose rate is taken


@dataclass(frozen=True, eq=False)
class MuscleRecord:
    """Rows of one record: the measured tension is law(pressure, contraction - lent) - friction - what damps. Of
    a muscle's k intervals in a cloth all but `time` is (n, k), and there is no `rate`."""

    time: Array  # (n,) s, rising
    pressure: Array  # (n,) Pa that acts
    contraction: Array  # (n,) as measured
    lent: Array  # (n,) contraction that the law does not see
    friction: Array  # (n,) N, against contraction

    @cached_property
    def rate(self) -> Array:
        """Return (n,) 1/s, of contraction: slope of the line through the rows around each one, for noise makes
        neighbours' differences useless."""
        half = min(_RATE_WINDOW, (len(self.time) - 1) // 2)
        kernel = np.arange(half, -half - 1, -1.0)
        inner = np.convolve(self.contraction, kernel, "valid") / np.convolve(self.time, kernel, "valid")
        return np.pad(inner, half, mode="edge")

    @staticmethod
    def measured(time: Array, pressure: Array, contraction: Array) -> "MuscleRecord":
        """Return the record as measured, without effects."""
        return MuscleRecord(time, pressure, contraction, np.zeros_like(contraction), np.zeros_like(contraction))


OfPlace = Callable[[Array, Array], Array]  # of places (u, v) [m] on the flat cloth


@dataclass(frozen=True, eq=False)
class Specimen:
    """The constants and places that a simulation of one case is made of.

    muscles: (m,) numbers of every muscle by name: `gain` (on what pressure adds to the tension), `lever` (on the axis'
    offset), `pressure_loss` (share of the pressure lost from a muscle's first end to its last), and those that an
    effect's force asks for by its planes' names (zero where none says otherwise). constants: numbers of the whole
    specimen that a force asks for, by name; places: those that differ over the cloth, of which a node gets the mean
    over its area. masses: (u [m], v [m], kg) each, fixed to the cloth.
    """

    design: Design
    factors: Mapping[str, float]
    order: int = 0
    muscles: Mapping[str, Array] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)
    places: Mapping[str, OfPlace] = field(default_factory=dict)
    masses: tuple[tuple[float, float, float], ...] = ()

    def with_fabric(self, fabric: Fabric) -> "Specimen":
        return replace(self, design=replace(self.design, fabric=fabric))

    def with_muscles(self, where: NDArray[np.bool_], **values: float | Array) -> "Specimen":
        """Return the specimen whose muscles' numbers by name are these where `where` (m,) holds, one for all or
        (m,)."""
        count = len(self.design.muscles)
        changed = {
            name: np.where(where, value, self.muscles.get(name, np.zeros(count))) for name, value in values.items()
        }
        return replace(self, muscles={**self.muscles, **changed})

    def with_constants(self, **values: float) -> "Specimen":
        return replace(self, constants={**self.constants, **values})

    def with_place(self, name: str, value: OfPlace) -> "Specimen":
        return replace(self, places={**self.places, name: value})

    def with_mass(self, u: float, v: float, mass: float) -> "Specimen":
        return replace(self, masses=(*self.masses, (u, v, mass)))


@dataclass(frozen=True, eq=False)
class ActingPressure:
    """Piecewise constant pressures, and where something has smoothed them, means over ticks.

    program: steps of pressure, whose jumps a simulator follows with short steps. smooth: (ticks, channels) Pa, means
    over ticks of `tick` s each from t = 0 on, the last holding for ever; None where the program itself acts.
    """

    program: PressureProgram
    ticks: int
    tick: float  # s
    smooth: Array | None = None

    @cached_property
    def means(self) -> Array:
        """Return (ticks, channels) Pa, over every tick."""
        if self.smooth is not None:
            return self.smooth
        return self.between(np.arange(self.ticks + 1))

    def between(self, edges: NDArray[np.int_]) -> Array:
        """Return (n - 1, channels) Pa, means between ticks `edges` (n,), rising; the last tick's holds beyond the
        ticks."""
        if self.smooth is None:
            return self.program.means(np.asarray(self.tick * edges, dtype=np.float64))
        integral = np.concatenate([np.zeros((1, self.smooth.shape[1])), np.cumsum(self.smooth, axis=0)])
        inside = np.minimum(edges, self.ticks)
        total = integral[inside] + (edges - inside)[:, None] * self.smooth[-1]
        return np.asarray(np.diff(total, axis=0) / np.diff(edges)[:, None])

    def at_once(self, change: Callable[[Array], Array]) -> "ActingPressure":
        """Return what a change that takes no time makes of the set points, and of what has smoothed them."""
        program = PressureProgram(self.program.time, change(self.program.pressure), self.program.duration)
        return self.through(program, None if self.smooth is None else change(self.smooth))

    def through(self, program: PressureProgram, smooth: Array | None) -> "ActingPressure":
        return replace(self, program=program, smooth=smooth)


Values = Mapping[str, float]
Site = Literal["muscle", "pneumatics", "fabric", "interface", "environment", "sensing", "learned"]
Scope = Literal["muscle type", "rig", "fabric", "sensors"]
SpecimenChange = Callable[[Specimen, Values, NDArray[np.bool_]], Specimen]


def to_muscles(**numbers: str) -> SpecimenChange:
    """Return what gives the muscles of a specimen an effect's parameters as numbers: plane="parameter"."""
    return lambda specimen, values, muscles: specimen.with_muscles(
        muscles, **{plane: values[name] for plane, name in numbers.items()}
    )


def to_constants(**numbers: str) -> SpecimenChange:
    """Return what gives a specimen an effect's parameters as constants: constant="parameter"."""
    return lambda specimen, values, _: specimen.with_constants(**{key: values[name] for key, name in numbers.items()})


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect, in `unit` in files and in the effect's own code.

    A strength has a value at which the effect is `off`, the centre of its prior; other parameters only shape the
    effect, about their typical value. Where both exist, several strengths are off together.
    """

    unit: str
    what: str
    typical: float  # the value where none is given
    bounds: tuple[float, float]
    # prior standard deviation, of the parameter or, by transform "log", of its logarithm
    deviation: Annotated[float, Key("prior.deviation")]
    off: float | None = None
    transform: Annotated[Literal["linear", "log"], Key("prior.transform")] = "linear"
    integer: bool = False  # a number of something, such as a channel: chosen, not fitted
    tried: tuple[float, ...] = ()  # where a fit of all effects has it, of a place as shares of the cloth: chosen too
    json_keys: ClassVar = (
        "unit",
        "what",
        "typical",
        "off",
        "bounds",
        ("prior.centre", "centre"),
        "deviation",
        "transform",
    )

    @property
    def centre(self) -> float:
        """Return the prior's centre."""
        return self.typical if self.off is None else self.off


@dataclass(frozen=True)
class Effect:
    """A declared effect.

    pressure(acting, values): the pressures that act. specimen(specimen, values, muscles): constants and geometry;
    muscles (m,) says which muscles the effect belongs to. clock(times, values): the instants [s] whose shape frames
    show; observed(points, values): points [m] as a sensor gives them. force: the kernel's part, a
    sim.forces.added.AddedForce or "module:NAME" of one. bench(record, values): what a muscle's law sees of a record on
    its bench, which begins settled, and in a cloth of its intervals' contractions along a motion; None where one muscle
    does not show the effect. remembers: whether what was before
    the present pressures still shows in the shape at rest. resists: whether its force is against motion alone, so that
    the derivatives of a shape at rest are near those without it. named: whether it stands for something physical;
    one that does not is fitted where it is asked for by its name, not with `all`, and is no answer of a trace.
    adds_up_to: the factor that the strengths of all its choices, moved alike, are the same as. same_from_rest: the
    effect that does the same, parameter for parameter, wherever motions begin at rest.
    """

    name: str
    site: Site
    scope: Scope
    what: str
    signature: str  # what it looks like in data, and what tells it from others
    source: str
    parameters: Mapping[str, EffectParameter]
    looks_like: str = ""  # what is no effect of the list and looks the same in data, and how to tell it apart
    pressure: Callable[[ActingPressure, Values], ActingPressure] | None = None
    specimen: SpecimenChange | None = None
    clock: Callable[[Array, Values], Array] | None = None
    observed: Callable[[NDArray[Any], Values], NDArray[Any]] | None = None
    force: Any = field(default=None, hash=False)
    bench: Callable[[MuscleRecord, Values], MuscleRecord] | None = None
    remembers: bool = False
    resists: bool = False
    named: bool = True
    adds_up_to: str = ""
    same_from_rest: str = ""
    json_keys: ClassVar = (
        "name", "site", "scope", "what", "signature", "looks_like", "source", "remembers", "parameters"
    )  # fmt: skip

    @property
    def pulls_by_record(self) -> bool:
        """Return whether its force follows from what a muscle's bench would record of the past. What goes with the rate
        alone is told from a lag by motions, not by frames in balance."""
        return self.force is not None and self.bench is not None and self.remembers

    @cached_property
    def strengths(self) -> tuple[str, ...]:
        """Return the parameters that switch it off."""
        return tuple(name for name, parameter in self.parameters.items() if parameter.off is not None)

    @property
    def chosen(self) -> tuple[str, ...]:
        """Return the parameters that a fit of all effects tries at some values: channels, and places."""
        return tuple(name for name, parameter in self.parameters.items() if parameter.integer or parameter.tried)

    def choices(self, channels: int, size: Mapping[str, float]) -> list[dict[str, float]]:
        """Return all combinations of what is chosen: a whole number is a channel of `channels`, a place a share of the
        cloth's `size` [m] along u and v."""
        values = [
            range(channels) if p.integer else [value * size.get(name, 1.0) for value in p.tried]
            for name, p in ((name, self.parameters[name]) for name in self.chosen)
        ]
        return [dict(zip(self.chosen, map(float, combination), strict=True)) for combination in product(*values)]

    def values(self, given: Values) -> dict[str, float]:
        """Return all parameters: those given, the others typical."""
        return {name: float(given.get(name, parameter.typical)) for name, parameter in self.parameters.items()}

    def is_off(self, given: Values) -> bool:
        """Return whether it changes nothing at these values."""
        parameters = self.parameters
        return bool(self.strengths) and all(
            given.get(name, parameters[name].typical) == parameters[name].off for name in self.strengths
        )
