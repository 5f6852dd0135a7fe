"""The result of a trace, as `trace.json` and as a model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.effects.learned import formula
from fabdesign.effects.registry import effects_of
from fabdesign.formats.result_tables import OfModel, Summary
from fabdesign.geometry.metrics import over
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import EffectTerm, Model
from fabdesign.nouns.trial import Role
from fabdesign.units import in_mm
from optimize.fit.fitted import Fit
from optimize.fit.misfit import frames_of
from optimize.fit.significance import undecided
from studies.fitting.fitted_model import far_factors, fitted_model, with_engines
from studies.measured.fit_data import MeasuredData
from studies.model_selection.judged import Judged
from studies.model_selection.outcome import TraceOutcome, When
from studies.model_selection.rules import Selection
from studies.model_selection.verdict import GROSS
from studies.prediction.evaluation_report import TrialResult
from studies.tracing.experiment import Explanation
from studies.tracing.residual_analysis import Remains, mean_of, other_layouts

_LITTLE = 0.1  # of its share, below which a frame's weight is told


@dataclass(frozen=True, eq=False)
class Outcome(TraceOutcome, OfModel):
    """The result of a trace of a set. Distances are in m. final: the model's fit, and what trials left out say of it:
    of the declared parameters alone unless effects or a formula were found."""

    metric: ClassVar = "surface_rms"
    scale: ClassVar = in_mm(1.0)
    unit: ClassVar = "mm"

    data: MeasuredData
    forward: ForwardModel
    alike: tuple[Explanation, ...]  # models that do as well, with another effect in the place of one chosen
    errors: tuple[TrialResult, ...]
    remains: Remains
    model: Model
    next_experiment: Mapping[str, Any] | None
    final: Judged
    json_keys: ClassVar = (
        *TraceOutcome.json_keys,
        ("other_layouts", "_other_layouts"),
        ("residual.where", "remains.where"), ("residual.when_s", "remains.when"), ("residual.follows", "follows"),
        ("unjudged", lambda of: of.data.used.stretches or ()), ("unjudged_share", "data.used.share_left_out"),
        ("weights.share_below_tenth", "share_below_tenth"), ("weights.input_accuracy", "data.accuracy"),
        ("decoys", "_decoys"), ("discovered", "_discovered"), "next_experiment",
        ("excess.unit", "unit"), ("excess.**", "excess_mm"), "detectable", ("said", "sentences"),
    )  # fmt: skip

    @property
    def name(self) -> str:
        return self.data.sets[0].name

    @property
    def synthetic(self) -> bool:
        return any("synthetic" in measured.description for measured in self.data.sets)

    @property
    def before(self) -> Fit:
        return self.selection.plain

    @property
    def after(self) -> Fit:
        return self.final.fit

    @property
    def discovered(self) -> Judged | None:
        """Return the fit with a formula; None without one."""
        return None if self.final in (self.selection.before, self.selection.judged) else self.final

    @property
    def effects(self) -> tuple[EffectTerm, ...]:
        """Return the effects that the verdict stands by, the one whose absence costs most first."""
        return tuple(self.named.values())

    @property
    def share_below_tenth(self) -> float:
        """Return the share of the frames that count for less than a tenth of their share."""
        state, counts = self.selection.everything.state, self.selection.everything.normal.counts
        means = np.array([counts[points].mean() for points in frames_of(state.misfit)[1]])
        return float(np.mean(means < _LITTLE * means.mean()))

    @property
    def _drift(self) -> float:
        """Return by how much the model without effects certainly changes over the session, m; 0 up to the tolerance."""
        return self.evidence.drift if self.verdict != "effect" and self.evidence.drift > self.tolerance else 0.0

    @property
    def follows(self) -> str | None:
        """Return what the residual goes with; None where with nothing."""
        return "order" if self._drift else self.remains.follows

    @property
    def sentences(self) -> list[str]:
        """Return lines for people."""
        lines = []
        if self.selection.small:
            names = effects_in_words(self.selection.small)
            lines.append(f"{names}: seen for certain, but too small to matter; not in the model")
        if self.verdict == "effect" and self.selection.slight:
            names = effects_in_words(self.selection.slight)
            lines.append(f"{names}: no more than in any careful build; in the model, which predicts better with it")
        if self.follows == "order":
            lines.append(
                f"what is left changes by {in_mm(self._drift or self.remains.drift):.2f} mm from the first trial to "
                "the last; to tell a drift over the session, repeat the first trial at its end"
            )
        lines += far_factors(self.after)
        measured = self.mean_error("test", "after")
        excess = 0.0 if measured is None else over(measured, self.floor)
        if self.verdict != "unexplained" and excess > GROSS * self.tolerance:
            lines.append(
                f"trials of role test are {in_mm(excess):.2f} mm over the noise: what acts there shows too little in "
                "those fitted; give some of them the role fit"
            )
        if (decoys := self.selection.decoys) is not None and decoys.gains:
            lines.append(
                f"names by chance: of {len(decoys.gains)} effects that cannot be there (driven by another trial's "
                f"pressures) {decoys.taken(self.tolerance) or 'none'} would have been called missing; one in twenty "
                f"gains {in_mm(decoys.chance):.2f} mm or more"
            )
        lines += [
            f"{effect.name}: the same in these data would be {EFFECTS[effect.name].looks_like}"
            for effect in {effect.name: effect for effect in self.effects}.values()
            if EFFECTS[effect.name].looks_like
        ]
        if self.share_below_tenth:
            inputs = self.data.accuracy
            lines.append(
                f"{self.share_below_tenth:.0%} of the frames count for less than a tenth of their share, since errors "
                f"of the inputs ({inputs.pressure:.1%} of each pressure, {inputs.tilt:g} degrees of "
                "level) move them most"
            )
        return lines

    def mean_error(self, role: Role, when: When) -> float | None:
        """Return the mean error of trials of a role, m; None where there are none."""
        return mean_of(self.errors, role, when)

    def excess(self, when: When) -> float:
        """Return the excess of trials left out, m."""
        return self.final.excess if when == "after" else self.evidence.before

    def summary(self) -> Summary:
        """Return the verdict, and the model's parameters."""
        return Summary([f"Outcome: {self.verdict}"], self.columns())

    @property
    def excess_mm(self) -> dict[str, float | None]:
        """Return the excess by what it is of; None: not known."""
        of = self.evidence
        values = {"before": of.before, "after": of.after, "black_box": of.box_before, "fitted": of.fitted}
        return {name: value and in_mm(value) for name, value in values.items()}

    @property
    def detectable(self) -> dict[str, Mapping[str, float]]:
        """Return the smallest value of each strength that would show, by candidate that is not in the model."""
        return {c.name: c.detectable for c in self.candidates if not c.chosen}

    @property
    def _other_layouts(self) -> dict[str, dict[str, float]]:
        return {
            name: {
                "trials": len(errors),
                **{which: in_mm(float(mean_of(errors, "test", which) or 0.0)) for which in ("before", "after")},
            }
            for name, errors in other_layouts(self.errors).items()
        }

    @property
    def _decoys(self) -> dict[str, float] | None:
        if (decoys := self.selection.decoys) is None:
            return None
        tried, taken = len(decoys.gains), decoys.taken(self.tolerance)
        return {"tried": tried, "taken": taken, "chance_mm": in_mm(decoys.chance)}

    @property
    def _discovered(self) -> dict[str, Any] | None:
        if self.discovered is None:
            return None
        effect = self.model.effects[-1]
        return {
            "formula": formula(effect.term.values),
            "parameters": {name: q for name, q in effect.parameters.items() if q.value},
            "excess_mm": {"before": in_mm(self.evidence.before), "after": in_mm(self.discovered.excess)},
        }


def noise_floor(errors: Sequence[TrialResult], otherwise: float) -> float:
    """Return `surface_floor` of the set, m."""
    of_roles = (mean_of(errors, role, "after", "surface_floor") for role in ("test", "fit"))
    return next((floor for floor in of_roles if floor is not None), otherwise)


def effects_in_words(labels: Sequence[str], between: str = ", ") -> str:
    """Return the effects of some labels, for people."""
    return between.join(name.replace("_", " ") for name in effects_of(labels))


def model_of(
    fit: Fit,
    selection: Selection,
    data: MeasuredData,
    *,
    points_per_side: int,
    known: tuple[EffectTerm, ...],
) -> Model:
    """Return a fit as a model, with the effects known before and the factors fitted without effects. What was not
    chosen may still act as far as the joint fit leaves it open, so that intervals are wider by it."""
    plain, joint = selection.plain, selection.everything
    minimum = joint.vector.inside(joint.minimum)
    model = fitted_model(
        fit if fit is plain else replace(fit, without_effects=plain),
        with_engines(fit) + undecided(minimum, joint.covariance, joint.vector.names, fit.x, fit.vector.names),
        trials=data.trials,
        points_per_side=points_per_side,
        provenance=data.provenance(),
    )
    return replace(model, effects=(*known, *model.effects))
