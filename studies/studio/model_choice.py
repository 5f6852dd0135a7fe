"""Which model the cloth follows: the data sheet or a model file, effects on switches, and the band of its intervals."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.registry import EFFECTS, effect_named
from fabdesign.errors import InputError
from fabdesign.geometry.shape import Shape
from fabdesign.nouns.array import Array
from fabdesign.nouns.model import NORMAL90, EffectTerm, Model, Quantity
from fabdesign.nouns.model_sampling import Ensemble

SHOWN = 2.0  # prior deviations off, for an effect that is switched on to be seen


@dataclass(frozen=True)
class ModelChoice:
    """The choice of a model. given: what `--model` brought, if anything. fitted: whether its factors, effects and
    corrector hold, or the data sheet. effect_values: of the effects that are on, by name, each parameter in the unit
    that the effect declares. corrected: whether the corrector acts, where the model has one."""

    given: Model | None = None
    fitted: bool = True
    effect_values: dict[str, dict[str, float]] = field(default_factory=dict)
    corrected: bool = True

    @staticmethod
    def of(given: Model | None) -> "ModelChoice":
        return ModelChoice(given, given is not None, _effect_values(given or Model()))

    @property
    def model(self) -> Model:
        """Return the model of all that is on. The corrector stays only beside the effects that it was trained with."""
        given = self.given or Model()
        base = given if self.fitted else Model(points_per_side=given.points_per_side)
        if _effect_values(base) == self.effect_values:
            return base if self.corrected else base.without(["corrector"])
        scopes = {effect.name: effect.scope for effect in given.effects}
        terms = []
        for name, values in self.effect_values.items():
            declared = EFFECTS[name].parameters
            quantities = {key: Quantity(value, declared[key].unit) for key, value in values.items()}
            terms.append(EffectTerm(name, quantities, scopes.get(name)))
        return replace(base, effects=tuple(terms), covariance=None, corrector=None, corrector_hash=None)

    @cached_property
    def around(self) -> list[Model]:
        """Return the models of which a band is made: two for each column of the covariance's root, one standard
        deviation to either side, without the corrector; none where the model has no joint covariance."""
        ensemble = Ensemble(self.model.without(["corrector"]))
        try:
            return [ensemble.at(sign * unit) for unit in np.eye(ensemble.size) for sign in (1.0, -1.0)]
        except InputError:
            return []

    def switched(self, name: str, on: bool) -> "ModelChoice":
        """Switch an effect on or off; on as the model has it, or by values that show."""
        effect_values = {k: v for k, v in self.effect_values.items() if k != name}
        if on:
            effect_values[name] = ModelChoice.of(self.given).effect_values.get(name) or visible(name)
        return replace(self, effect_values=effect_values)

    def with_value(self, name: str, parameter: str, value: float) -> "ModelChoice":
        """Give a parameter another value, within its bounds, if its effect is on."""
        if name not in self.effect_values:
            return self
        low, high = EFFECTS[name].parameters[parameter].bounds
        values = {**self.effect_values[name], parameter: min(max(float(value), low), high)}
        return replace(self, effect_values={**self.effect_values, name: values})

    def sheet(self, fitted: bool) -> "ModelChoice":
        """Take the model file (fitted) with its effects, or the data sheet with none."""
        choice = ModelChoice.of(self.given) if fitted else ModelChoice(self.given, False)
        return replace(choice, corrected=self.corrected)

    @property
    def has_corrector(self) -> bool:
        return self.given is not None and self.given.corrector is not None


def visible(name: str) -> dict[str, float]:
    """Return an effect's parameters: strengths as far from off as its prior lets one expect, the others typical."""
    effect = EFFECTS[name]
    values = effect.values({})
    for key in effect.strengths:
        parameter = effect.parameters[key]
        off = parameter.off or 0.0
        by = SHOWN * parameter.deviation
        value = off * (1 + by) if parameter.transform == "log" and off else off + by
        values[key] = min(max(value, parameter.bounds[0]), parameter.bounds[1])
    return values


def _effect_values(model: Model) -> dict[str, dict[str, float]]:
    return {effect.name: effect_named(effect.name, "model").values(effect.term.values) for effect in model.effects}


def lower_edge(points: NDArray[np.float32]) -> Array:
    """Return the mid-surface's last row (n, 3) m of a shape (2 n^2, 3) m."""
    return np.asarray(Shape.of(points).middle[-1], dtype=np.float64)


def half_band(shapes: list[NDArray[np.float32]]) -> Array:
    """Return the effect of a model's intervals on the lower edge, to first order: (n, 3) m to either side, which holds
    90 %, in x, y and z. shapes: under the models `around`, in their order: half the difference of two is a column of
    deviations, and deviations of independent columns add up squared."""
    edges = np.array([lower_edge(shape) for shape in shapes]).reshape(-1, 2, len(lower_edge(shapes[0])), 3)
    columns = (edges[:, 0] - edges[:, 1]) / 2
    return np.asarray(NORMAL90 * np.sqrt(np.square(columns).sum(axis=0)))
