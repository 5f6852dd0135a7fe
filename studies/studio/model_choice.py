"""Which model the cloth follows: the data sheet or a model file, and effects on switches with their parameters."""

from dataclasses import dataclass, field, replace
from functools import cached_property

from fabdesign.effects.registry import EFFECTS, effect_named
from fabdesign.model import EffectTerm, Model, Quantity
from studies.studio.band import models_around

SHOWN = 2.0  # prior deviations off, for an effect that is switched on to be seen


@dataclass(frozen=True)
class ModelChoice:
    """given: what `--model` brought, if anything. fitted: whether its factors, effects and corrector hold, or the data
    sheet. effect_values: of the effects that are on, by name, each parameter in the unit that the effect declares.
    corrected: whether the corrector acts, where the model has one."""

    given: Model | None = None
    fitted: bool = True
    effect_values: dict[str, dict[str, float]] = field(default_factory=dict)
    corrected: bool = True

    @staticmethod
    def of(given: Model | None) -> "ModelChoice":
        if given is None:
            return ModelChoice(None, False)
        on = {effect.name: effect_named(effect.name, "model").values(effect.term.values) for effect in given.effects}
        return ModelChoice(given, True, on)

    @property
    def model(self) -> Model:
        """Of all that is on. The corrector stays only where the effects are those that it was trained beside."""
        base = self.given if self.given is not None and self.fitted else None
        if base is None:
            base = Model() if self.given is None else Model(points_per_side=self.given.points_per_side)
        scopes = {effect.name: effect.scope for effect in (self.given.effects if self.given else ())}
        terms = tuple(
            EffectTerm(
                name, {k: Quantity(v, EFFECTS[name].parameters[k].unit) for k, v in values.items()}, scopes.get(name)
            )
            for name, values in self.effect_values.items()
        )
        own = {effect.name: effect_named(effect.name, "model").values(effect.term.values) for effect in base.effects}
        if own == self.effect_values:
            return base if self.corrected else base.without(["corrector"])
        return replace(base, effects=terms, covariance=None, corrector=None, corrector_hash=None)

    @cached_property
    def around(self) -> list[Model]:
        """Those of which a band is made; none where its intervals are not known."""
        return models_around(self.model)

    def switched(self, name: str, on: bool) -> "ModelChoice":
        """An effect on or off; on as the model has it, or by values that show."""
        effect_values = {k: v for k, v in self.effect_values.items() if k != name}
        if on:
            fitted = ModelChoice.of(self.given).effect_values if self.given else {}
            effect_values[name] = fitted.get(name) or visible(name)
        return replace(self, effect_values=effect_values)

    def with_value(self, name: str, parameter: str, value: float) -> "ModelChoice":
        low, high = EFFECTS[name].parameters[parameter].bounds
        values = {**self.effect_values[name], parameter: min(max(value, low), high)}
        return replace(self, effect_values={**self.effect_values, name: values})

    def sheet(self, fitted: bool) -> "ModelChoice":
        """The model file (fitted) with its effects, or the data sheet with none."""
        choice = ModelChoice.of(self.given) if fitted else ModelChoice(self.given, False)
        return replace(choice, corrected=self.corrected)

    @property
    def has_corrector(self) -> bool:
        return self.given is not None and self.given.corrector is not None


def visible(name: str) -> dict[str, float]:
    """An effect's parameters: strengths so far from off as its prior lets one expect, the others typical."""
    effect = EFFECTS[name]
    values = effect.values({})
    for key in effect.strengths:
        parameter = effect.parameters[key]
        off = parameter.off or 0.0
        by = SHOWN * parameter.deviation
        value = off * (1 + by) if parameter.transform == "log" and off else off + by
        values[key] = min(max(value, parameter.bounds[0]), parameter.bounds[1])
    return values
