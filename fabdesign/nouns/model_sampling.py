"""Models drawn from a model's joint covariance: whoever samples a model samples jointly. And 90 % intervals of a
predicted motion: how wide a model's `Spread` says they are, and for which model it holds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fabdesign.effects.registry import effect_named, labels_of
from fabdesign.errors import InputError
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import FACTOR_RANGE
from fabdesign.nouns.model import Model, Spread
from fabdesign.runtime.fingerprint import sha256


def joint_root(model: Model) -> Array:
    """Return (n, n) lower triangle L with L L^T the covariance, which L z has for independent standard normals z.

    Raises InputError for a model without a covariance, or with one of names that it does not have.
    """
    if model.covariance is None:
        raise InputError("the model has no [covariance]; expected one, as calibrate and trace write it")
    for name in model.covariance.names:
        _centre(model, name)
    matrix = model.covariance.matrix
    try:
        return np.asarray(np.linalg.cholesky(matrix + 1e-12 * np.trace(matrix) * np.eye(len(matrix))))
    except np.linalg.LinAlgError:
        raise InputError("the model's [covariance] is no covariance: a direction has a negative variance") from None


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Models that a model's joint covariance leaves possible: a vector of independent standard normals z stands for
    each. The centre is the model itself; the corrector stays the one trained there."""

    model: Model

    @cached_property
    def root(self) -> Array:
        """Return `joint_root`, (0, 0) of a model without a covariance, which stands for itself."""
        return np.empty((0, 0)) if self.model.covariance is None else joint_root(self.model)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the parameters that differ."""
        return () if self.model.covariance is None else self.model.covariance.names

    @property
    def size(self) -> int:
        """Return how many normals stand for a model."""
        return len(self.names)

    def at(self, z: Sequence[float] | Array) -> Model:
        """Return the model with its parameters at centre + root z, in their transforms, within their bounds."""
        parameters, effects = dict(self.model.parameters), list(self.model.effects)
        for name, shift in zip(self.names, self.root @ np.asarray(z), strict=True):
            centre, logarithmic, (low, high) = _centre(self.model, name)
            value = float(np.clip(centre * np.exp(shift) if logarithmic else centre + shift, low, high))
            if name in parameters:
                parameters[name] = replace(parameters[name], factor=value)
                continue
            effect, _, key = name.rpartition(".")
            i = labels_of(self.model.terms).index(effect)
            quantity = replace(effects[i].parameters[key], value=value)
            effects[i] = replace(effects[i], parameters={**effects[i].parameters, key: quantity})
        return replace(self.model, parameters=parameters, effects=tuple(effects))

    def drawn(self, count: int, seed: int) -> list[Model]:
        """Return so many models, the same wherever a model is asked; none without a covariance."""
        return (
            [self.at(z) for z in np.random.default_rng(seed).standard_normal((count, self.size))] if self.size else []
        )


def covered(model: Model) -> set[str]:
    """Return what the covariance covers, as a case calls it: names of factors, and effects.NAME.PARAMETER."""
    names = model.covariance.names if model.covariance is not None else ()
    factors = {n for name in names if name in model.parameters for n in Model({name: model.parameters[name]}).factors}
    return factors | {f"effects.{name}" for name in names if name not in model.parameters}


class _Centre(NamedTuple):
    """The value of a parameter, whether its logarithm is what is normal, and its bounds."""

    value: float
    logarithmic: bool
    bounds: tuple[float, float]


def _centre(model: Model, name: str) -> _Centre:
    if name in model.parameters:
        return _Centre(model.parameters[name].factor, True, FACTOR_RANGE)
    effect, _, key = name.rpartition(".")
    for label, term in zip(labels_of(model.terms), model.effects, strict=True):
        if label == effect and key in term.parameters:
            declared = effect_named(term.name, "covariance").parameters[key]
            return _Centre(term.parameters[key].value, declared.transform == "log", declared.bounds)
    raise InputError(f"the model's [covariance] names {name}; expected parameters that the model has")


def half_widths(spread: Spread, deviation: Array, moved: Array, design: str = "") -> Array:
    """Return half-widths [m], of any shape. deviation: m, standard deviation over models drawn from the joint
    covariance. moved: m since rest. design: its name; one that the spread does not know has the width of all
    together."""
    squares = spread.constant**2 + (spread.covariance * deviation) ** 2 + (spread.motion * moved) ** 2
    return np.asarray(spread.designs.get(design, 1.0) * np.sqrt(squares))


def spread_hash(model: Model) -> str:
    """Return the SHA-256 of all that a predicted motion and its covariance depend on: central values, covariance,
    corrector."""
    covariance = model.covariance
    joint = "" if covariance is None else repr((covariance.names, covariance.matrix.tolist()))
    return sha256(model.central_hash, joint, "" if model.corrector is None else sha256(model.corrector))


def spread_of(model: Model) -> Spread | None:
    """Return the model's; None also where the model was changed since it was calibrated."""
    return model.spread if model.spread is not None and model.spread.trained_on == spread_hash(model) else None
