"""This module makes the unknowns of a fit from what `--free` and `--fix` name."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from fabdesign.effects import Effect
from fabdesign.effects.registry import EFFECTS, check_values, effect_named, labels_of
from fabdesign.errors import InputError
from fabdesign.formats.table import nearest
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import MUSCLE_TYPES, OF_MUSCLES, PARAMETERS, Term
from optimize.fit.parameters import DECLARED, PRIOR, FitParameter, FitVector

START = 0.5  # of the way from off to its typical value, where a strength begins


def fit_vector(
    free: Sequence[str] = (),
    fixed: Sequence[str] = (),
    *,
    factors: dict[str, float] | None = None,
    terms: Iterable[Term] = (),
    designs: Sequence[Design] = (),
    scope: str | None = None,
    where: str = "--free",
) -> FitVector:
    """Return the declared parameters less those `fixed`, and what `free` adds: EFFECT (all of its parameters),
    EFFECT.PARAMETER, EFFECT:PARAMETER=VALUE (one that is chosen, not fitted), muscle_types.NAME.PARAMETER, or "all":
    the strengths of every effect, of one that is somewhere or in some channel at every choice that it declares.

    factors, terms: a model's: what is held has their values, and what is free begins there. designs: that are fitted;
    without any no channel is known. scope: of the muscles' effects that are added, by default that of the one muscle
    type of the designs. Raises InputError.
    """  # fmt: skip
    for name in fixed:
        if name not in PARAMETERS:
            raise InputError(f"--fix {name}: expected one of {', '.join(PARAMETERS)}{nearest(name, PARAMETERS)}")
    known = factors or {}
    held = {name: factor for name, factor in known.items() if name.rpartition(".")[2] in fixed}
    parameters = [
        replace(p, start=p.unknown(known.get(p.name, 1.0))) for p in DECLARED.parameters if p.name not in fixed
    ]
    effects = _Effects(terms, scope or muscle_scope(designs))
    for item in free:
        if item.startswith(MUSCLE_TYPES):
            parameters.append(_of_muscles(item, where))
        elif item == "all":
            effects.free_all(designs)
        else:
            effects.free(item, where)
    return FitVector((*parameters, *effects.parameters()), tuple(held.items()), tuple(effects.terms))


def muscle_scope(designs: Sequence[Design]) -> str | None:
    """Return the scope of the one muscle type that all designs use; None where there are several, or none."""
    types = {muscle.type for design in designs for muscle in design.muscles}
    return f"{MUSCLE_TYPES}{types.pop()}" if len(types) == 1 else None


class _Effects:
    """The terms of a vector that is put together, and where those of their parameters begin that are free."""

    def __init__(self, terms: Iterable[Term], scope: str | None) -> None:
        self.terms = [*terms]
        self.starts: list[dict[str, float]] = [{} for _ in self.terms]  # x, by parameter
        self.scope = scope

    def free(self, item: str, where: str) -> None:
        """Free EFFECT, EFFECT.PARAMETER or EFFECT:PARAMETER=VALUE, of each term of that effect, or of a new one."""
        name, _, given = item.partition(":")
        name, _, only = name.partition(".")
        effect = effect_named(name, f"{where} {item}")
        if only and only not in effect.parameters:
            check_values(effect, {only: 0.0}, f"{where} {item}")  # raises
        chosen = _chosen(effect, given, f"{where} {item}") if given else {}
        places = [k for k, term in enumerate(self.terms) if term.name == name]
        if chosen and len(places) > 1:
            places = [k for k in places if chosen.items() <= self.terms[k].values.items()]
        for k in places or [self._added(effect, {})]:
            self.terms[k] = replace(self.terms[k], values={**self.terms[k].values, **chosen})
            keys = [only] if only else [key for key in effect.parameters if key not in chosen]
            self._begin(k, effect, [key for key in keys if not effect.parameters[key].integer])

    def free_all(self, designs: Sequence[Design]) -> None:
        """Free the strengths of every effect that has a name. What has a choice and no term yet begins at nothing, at
        each of its choices."""
        channels = max((design.channels for design in designs), default=0)
        size = {"u": designs[0].fabric.width, "v": designs[0].fabric.height} if designs else {"u": 0.2, "v": 0.2}
        for effect in EFFECTS.values():
            places = [k for k, term in enumerate(self.terms) if term.name == effect.name]
            if effect.named and effect.chosen and not places:
                for values in effect.choices(channels, size):
                    self.starts[self._added(effect, values)].update(dict.fromkeys(effect.strengths, 0.0))
            elif effect.named:
                for k in places or [self._added(effect, {})]:
                    self._begin(k, effect, effect.strengths)

    def parameters(self) -> list[FitParameter]:
        """Return the unknowns, in the order of the terms."""
        return [
            replace(_unknown(EFFECTS[term.name], key, f"{label}.{key}"), start=start)
            for label, term, starts in zip(labels_of(self.terms), self.terms, self.starts, strict=True)
            for key, start in starts.items()
        ]

    def _added(self, effect: Effect, values: dict[str, float]) -> int:
        self.terms.append(Term(effect.name, values, self.scope if effect.scope == "muscle type" else None))
        self.starts.append({})
        return len(self.terms) - 1

    def _begin(self, k: int, effect: Effect, keys: Iterable[str]) -> None:
        """Free parameters of a term, if they were not: from where the term has them, or on the way to typical."""
        given = self.terms[k].values
        for key in keys:
            parameter = effect.parameters[key]
            share = START if parameter.off is not None and key not in given else 1.0
            begin = _unknown(effect, key, key).unknown(given.get(key, parameter.typical))
            self.starts[k].setdefault(key, share * begin)


def _unknown(effect: Effect, key: str, name: str) -> FitParameter:
    p = effect.parameters[key]
    return FitParameter(name, p.deviation, p.centre, p.transform, p.unit, p.bounds)


def _chosen(effect: Effect, given: str, where: str) -> dict[str, float]:
    """Return PARAMETER=VALUE as a mapping. Raises InputError."""
    key, _, value = given.partition("=")
    try:
        number = float(value)
    except ValueError:
        raise InputError(f"{where}: expected {effect.name}:PARAMETER=NUMBER") from None
    check_values(effect, {key: number}, where)
    return {key: number}


def _of_muscles(item: str, where: str) -> FitParameter:
    name = item.rpartition(".")[2]
    if name not in OF_MUSCLES:
        raise InputError(f"{where} {item}: expected {MUSCLE_TYPES}NAME.{' or '.join(OF_MUSCLES)}")
    return FitParameter(item, PRIOR[name])
