"""The dictionary: what each effect would change, at a few shapes and sizes, differenced once at the refitted model."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from fabdesign.effects import EFFECTS, Effect
from fabdesign.forward import Term
from fabdesign.splits import by_program
from studies.tracing.fit import Bench, State, rows_kept
from studies.tracing.vector import WIDE, Added, Array, scope_of, value_at

SIZES = 0.5, 2.0  # of a strength, in prior standard deviations
SHAPES = -1.5, 0.0, 1.5  # of a parameter that shapes an effect, the same, about its typical value
MOST_CHOICES = 16  # of a whole parameter, such as a channel


@dataclass(frozen=True)
class Column:
    """One strength of an effect at one size, its shape fixed."""

    effect: str
    strength: str
    values: Mapping[str, float]  # all of the effect's


@dataclass(frozen=True)
class Variant:
    """A candidate at one shape and size: columns that are taken together."""

    effect: str
    columns: tuple[int, ...]  # of the dictionary
    size: float
    shape: Mapping[str, float]  # values of what is not a strength
    decoy: bool = False

    @property
    def deviation(self) -> float:
        """Of the columns' coefficients, by the prior."""
        return WIDE / self.size


@dataclass(frozen=True, eq=False)
class Dictionary:
    """columns: (N, k) m, zero where a point says nothing. Decoys are every column with another trial's change."""

    entries: tuple[Column, ...]
    variants: tuple[Variant, ...]
    columns: Array

    @property
    def effects(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(v.effect for v in self.variants))


def entries_of(channels: int, known: Collection[str] = ()) -> tuple[tuple[Column, ...], tuple[Variant, ...]]:
    """Columns and variants of all registered effects but those in `known`, for designs with so many channels."""
    columns: list[Column] = []
    variants: list[Variant] = []
    for effect in EFFECTS.values():
        if effect.name in known or not effect.strengths:
            continue
        for shape, sizes in _shapes(effect, channels):
            for size in sizes:
                own = []
                for strength in effect.strengths:
                    off = {name: effect.parameters[name].off for name in effect.strengths}
                    values = {**shape, **off, strength: value_at(effect.parameters[strength], size)}
                    own.append(len(columns))
                    columns.append(
                        Column(effect.name, strength, {k: float(v) for k, v in values.items() if v is not None})
                    )
                variants.append(Variant(effect.name, tuple(own), size, shape))
    return tuple(columns), tuple(variants)


def _shapes(effect: Effect, channels: int) -> list[tuple[dict[str, float], tuple[float, ...]]]:
    """Values of the parameters that are no strength, and the sizes of the strengths to look at."""
    choices: dict[str, list[float]] = {}
    whole = False
    for name, parameter in effect.parameters.items():
        if parameter.off is not None:
            continue
        if parameter.whole:
            whole = True
            choices[name] = [float(k) for k in range(min(channels, MOST_CHOICES))]
        else:
            choices[name] = [value_at(parameter, x) for x in SHAPES]
    sizes = (1.0,) if whole else SIZES
    return [(dict(zip(choices, values, strict=True)), sizes) for values in product(*choices.values())]


def dictionary(bench: Bench, state: State, *, types: list[str], channels: int, known: Sequence[str] = ()) -> Dictionary:
    """Every effect that is not in the model yet, added to it at the state, and decoys."""
    entries, variants = entries_of(channels, [*known, *(added.name for added in state.vector.added)])
    rows = [
        [
            state.vector.case(s.trial, state.x, (Term(e.effect, e.values, scope_of(e.effect, types)),))
            for s in bench.samples
        ]
        for e in entries
    ]
    ahead = _another_program(bench)
    true, *decoys = bench.columns(state, rows, (0, *([ahead] if ahead else [])))
    columns = np.concatenate([rows_kept(state, part) for part in (true, *decoys)], axis=1)
    if decoys:
        count = len(entries)
        variants += tuple(
            Variant(v.effect, tuple(count + c for c in v.columns), v.size, v.shape, decoy=True) for v in variants
        )
    return Dictionary(entries, variants, columns)


def _another_program(bench: Bench) -> int:
    """By how many trials the decoys are off, so that none meets its own program or a repeat of it; 0: there is none."""
    trials = [sample.trial for sample in bench.samples]
    group = {id(t): k for k, group in enumerate(by_program(trials)) for t in group}
    for shift in range(1, len(trials)):
        if all(group[id(t)] != group[id(trials[(k + shift) % len(trials)])] for k, t in enumerate(trials)):
            return shift
    return 0


def added_of(variant: Variant, coefficients: Sequence[float], types: list[str]) -> tuple[Added, Array]:
    """The effect as it enters a fit, and where its parameters start (in prior standard deviations): at what the
    linear fit found, a tenth of it inside its bounds."""
    effect = EFFECTS[variant.effect]
    fixed = {name: v for name, v in variant.shape.items() if effect.parameters[name].whole}
    free = tuple(name for name in effect.parameters if name not in fixed)
    added = Added(variant.effect, free, fixed, scope_of(variant.effect, types))
    start = []
    found = dict(zip(effect.strengths, coefficients, strict=True))
    for name in free:
        parameter = effect.parameters[name]
        if name in found:
            start.append(float(np.clip(found[name] * variant.size, -4.0, 4.0)))
        else:
            shape = variant.shape[name]
            moved = np.log(shape / parameter.typical) if parameter.transform == "log" else shape - parameter.typical
            start.append(float(moved / parameter.deviation))
    if all(
        value_at(effect.parameters[n], x) == effect.parameters[n].off
        for n, x in zip(free, start, strict=True)
        if n in found
    ):
        start = [
            0.25 if n in found else x for n, x in zip(free, start, strict=True)
        ]  # off: its shape would say nothing
    return added, np.array(start)


def starts_of(added: Added, begin: Array, lengths: Sequence[float]) -> list[Array]:
    """Where a fit of an effect may start: `begin`, its strengths times each of `lengths`, and with strengths that are
    alike (a linear fit trades one for the other)."""
    strengths = [k for k, name in enumerate(added.free) if name in EFFECTS[added.name].strengths]
    starts = []
    for alike in (False, True) if len(strengths) > 1 else (False,):
        for length in lengths:
            start = begin.copy()
            own = length * start[strengths]
            start[strengths] = np.mean(np.abs(own)) if alike else own
            starts.append(np.clip(start, -4.0, 4.0))
    return starts
