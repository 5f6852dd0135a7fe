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

    def entries(self) -> dict[str, Any]:
        """Return what `trace.json` says of a set and of a bench."""
        scale, evidence = self.scale, self.evidence
        none = Candidate("none", 0.0, (0.0, 0.0), evidence.before, max(evidence.typical, evidence.drift), False)

        def held_out(excess: float) -> float:
            return scale * float(np.hypot(excess, self.floor))

        def errors(when: When) -> dict[str, float | None]:
            fit, test = (self.mean_error(role, when) for role in ("fit", "test"))
            left_out = held_out(self.excess(when))
            shown = left_out if test is None else scale * test
            return {"fit": fit and scale * fit, "held_out": shown, "cross_validated": left_out}

        return {
            "format": "fabdesign.trace/1",
            "verdict": self.verdict,
            "effects": [
                {
                    "name": effect.name,
                    "site": EFFECTS[effect.name].site,
                    "scope": effect.scope or EFFECTS[effect.name].scope,
                    "parameters": effect.parameters,
                    "explains": self.explained.get(label),
                }
                for label, effect in self.named.items()
            ],
            "indistinguishable": self.indistinguishable,
            "candidates": [
                {
                    "name": c.name,
                    "held_out": held_out(c.excess),
                    "gain": scale * c.gain,
                    "interval90": [scale * end for end in c.interval90],
                    "adequate": c.adequate(self.tolerance),
                    "chosen": c.chosen and self.verdict == "effect",
                }
                for c in (none, *self.candidates)
            ],
            "error": {
                "metric": self.metric,
                "unit": self.unit,
                "noise_floor": scale * self.floor,
                "tolerance": scale * self.tolerance,
                "ceiling": held_out(evidence.box_before),
                "before": errors("before"),
                "after": errors("after"),
            },
        }


def write_trace(files: Path, outcome: TraceOutcome, model: Model, html: str) -> None:
    """Write `trace.json`, `model.toml` and `report.html` into a folder."""
    write_json(files / "trace.json", outcome)
    write_model(model, files / "model.toml")
    write_text(files / "report.html", html)
