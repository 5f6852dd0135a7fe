"""The outcome of a trace, of a set as of a bench: what `trace.json` says of both, and the files of its folder."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.files.model_file import write_model
from fabdesign.formats.json_file import write_json
from fabdesign.formats.result_tables import Tabled
from fabdesign.nouns.model import EffectTerm, Model
from fabdesign.nouns.trial import Role
from fabdesign.output import write_text
from studies.model_selection.rules import Selection
from studies.model_selection.verdict import Evidence, Word, explains

When = Literal["before", "after"]


@dataclass(frozen=True)
class ShownErrors:
    """Errors of a model, as `trace.json` has them. held_out: of those of role test, where there are any."""

    fit: float | None
    held_out: float
    cross_validated: float


@dataclass(frozen=True)
class CandidateRow:
    """A candidate, as `trace.json` has it."""

    name: str
    held_out: float
    gain: float
    interval90: tuple[float, float]
    adequate: bool
    chosen: bool


@dataclass(frozen=True)
class Candidate:
    """An effect. gain: m, or the bench's unit, of excess, in quadrature, that trials or records left out gain by it: of
    a set's beside the effects chosen, to first order; of a bench's by itself. excess, typical: of the model with it, in
    the mean and the median of those left out. detectable: the smallest value of each strength that would show. refused:
    whether it takes structure, but with a sign that it cannot have."""

    name: str
    gain: float
    interval90: tuple[float, float]
    excess: float
    typical: float
    chosen: bool
    detectable: Mapping[str, float] = field(default_factory=dict)
    refused: bool = False

    def adequate(self, tolerance: float) -> bool:
        """Return whether the model with it leaves no more than the tolerance, in the mean and in the median."""
        return max(self.excess, self.typical) <= tolerance


@dataclass(frozen=True, eq=False)
class TraceOutcome(Tabled):
    """The outcome of a trace. Errors in m, or in the bench's unit. floor: the noise of what is compared. named: the
    effects that the verdict stands by, by their label in the fit. indistinguishable: those that would do as well.
    metric, unit: of errors in `trace.json`; scale: what errors are times there."""

    metric: ClassVar[str]
    scale: ClassVar[float] = 1.0

    verdict: Word
    evidence: Evidence
    tolerance: float
    floor: float
    selection: Selection
    candidates: tuple[Candidate, ...]
    named: Mapping[str, EffectTerm]
    indistinguishable: tuple[str, ...]
    json_keys: ClassVar[tuple[Any, ...]] = (
        ("format", lambda of: "fabdesign.trace/1"),
        "verdict", ("effects", "_effects"), "indistinguishable", ("candidates", "rows"),
        ("error.metric", "metric"), ("error.unit", "unit"),
        ("error.noise_floor", lambda of: of.scale * of.floor), ("error.tolerance", lambda of: of.scale * of.tolerance),
        ("error.ceiling", lambda of: of.held_out(of.evidence.box_before)),
        ("error.before", lambda of: of.errors_shown("before")), ("error.after", lambda of: of.errors_shown("after")),
    )  # fmt: skip

    @cached_property
    def explained(self) -> dict[str, float]:
        """Return the share of the gap that each effect closes; of several, by what its absence costs."""
        share = explains(self.evidence)
        costs = {label: max(gain, 0.0) ** 2 for label, (gain, _) in self.selection.gains.items()}
        every = max(sum(costs.values()), 1e-30)
        return {} if share is None else {label: share * cost / every for label, cost in costs.items()}

    @property
    def unit(self) -> str:
        raise NotImplementedError

    def mean_error(self, role: Role, when: When) -> float | None:
        """Return the mean error of trials or records of a role; None where there are none."""
        raise NotImplementedError

    def excess(self, when: When) -> float:
        """Return the excess of trials or records left out, after by the model that is written."""
        return self.evidence.after if when == "after" and self.verdict == "effect" else self.evidence.before

    def held_out(self, excess: float) -> float:
        """Return the error of what is left out by its excess, as `trace.json` has it."""
        return self.scale * float(np.hypot(excess, self.floor))

    def errors_shown(self, when: When) -> ShownErrors:
        """Return the errors before or after."""
        fit, test = (self.mean_error(role, when) for role in ("fit", "test"))
        left_out = self.held_out(self.excess(when))
        return ShownErrors(fit and self.scale * fit, left_out if test is None else self.scale * test, left_out)

    @property
    def compared(self) -> list[float]:
        """Return the noise floor, and the errors held out of the baseline, after and before."""
        before, after = (self.errors_shown(when).held_out for when in ("before", "after"))
        return [self.scale * self.floor, self.held_out(self.evidence.box_before), after, before]

    @property
    def _effects(self) -> list[dict[str, Any]]:
        return [
            {
                "name": effect.name,
                "site": EFFECTS[effect.name].site,
                "scope": effect.scope or EFFECTS[effect.name].scope,
                "parameters": effect.parameters,
                "explains": self.explained.get(label),
            }
            for label, effect in self.named.items()
        ]

    @property
    def rows(self) -> list[CandidateRow]:
        """Return a row a candidate; the first is the model without effects."""
        evidence = self.evidence
        none = Candidate("none", 0.0, (0.0, 0.0), evidence.before, max(evidence.typical, evidence.drift), False)
        return [
            CandidateRow(
                name=c.name,
                held_out=self.held_out(c.excess),
                gain=self.scale * c.gain,
                interval90=(self.scale * c.interval90[0], self.scale * c.interval90[1]),
                adequate=c.adequate(self.tolerance),
                chosen=c.chosen and self.verdict == "effect",
            )
            for c in (none, *self.candidates)
        ]


def write_trace(files: Path, outcome: TraceOutcome, model: Model, html: str) -> None:
    """Write `trace.json`, `model.toml` and `report.html` into a folder."""
    write_json(files / "trace.json", outcome)
    write_model(model, files / "model.toml")
    write_text(files / "report.html", html)
