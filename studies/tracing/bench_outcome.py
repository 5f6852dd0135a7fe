"""What a trace of a bench came to."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fabdesign.bench import Bench
from fabdesign.effects import EFFECTS
from fabdesign.model import EffectTerm
from studies.tracing.bench_ranking import Array, Ranking
from studies.tracing.verdict import Evidence, Word

_SITES = {"stress_relaxation": ("fabric", "fabric"), "muscle_viscosity": ("muscle", "muscle type"),
          "stroke_softening": ("muscle", "rig")}  # fmt: skip
Curve = tuple[str, Array, Array, Array, Array]  # a record: its name, the rows' place, measured, before, after


@dataclass(frozen=True, eq=False)
class BenchOutcome:
    """Of a trace of a bench. Errors in the output's SI unit, RMS of records left out."""

    bench: Bench
    unit: str
    verdict: Word
    evidence: Evidence
    tolerance: float
    floor: float
    first: Ranking
    found: tuple[EffectTerm, ...]
    shares: Mapping[str, float]
    indistinguishable: tuple[str, ...]
    refused: tuple[str, ...]  # candidates that would explain some, but only with a sign that they cannot have
    fit: tuple[float, float]  # before, after
    test: tuple[float, float] | None  # the same on records of role test, looked at once; None without any
    curves: tuple[Curve, ...]

    def as_json(self) -> dict[str, Any]:
        """`trace.json`."""
        added = self.verdict == "effect"
        crossed = (self.evidence.before, self.evidence.after)
        held_out = self.test or tuple(float(np.hypot(excess, self.floor)) for excess in crossed)
        rows = [{"name": "none", "held_out": self.first.none_held_out, "gain": 0.0, "interval90": [0.0, 0.0],
                 "adequate": self.evidence.before <= self.tolerance}]  # fmt: skip
        rows += [
            {"name": c.effect, "held_out": c.held_out, "gain": c.gain, "interval90": list(c.interval90),
             "adequate": max(self.evidence.before - c.gain, 0.0) <= self.tolerance}
            for c in self.first.candidates
        ]  # fmt: skip
        return {
            "format": "fabdesign.trace/1",
            "verdict": self.verdict,
            "effects": [_effect(e, self.shares.get(e.name)) for e in self.found] if self.verdict == "effect" else [],
            "indistinguishable": list(self.indistinguishable) if self.verdict == "effect" else [],
            "candidates": sorted(rows, key=lambda row: float(str(row["held_out"]))),
            "error": {
                "metric": "rms",
                "unit": self.unit,
                "noise_floor": self.floor,
                "tolerance": self.tolerance,
                "ceiling": float(np.hypot(self.evidence.box_before, self.floor)),
                "before": {"fit": self.fit[0], "held_out": held_out[0]},
                "after": {"fit": self.fit[added], "held_out": held_out[added]},
            },
            "residual": {"where": None, "when_s": None, "follows": None},
            "unjudged": [],
            "discovered": None,
            "next_experiment": None,
        }


def _effect(effect: EffectTerm, explained: float | None) -> dict[str, Any]:
    declared = EFFECTS.get(effect.name)
    site, scope = (declared.site, declared.scope) if declared else _SITES[effect.name]
    return {
        "name": effect.name,
        "site": site,
        "scope": effect.scope or scope,
        "parameters": {n: q.as_json() for n, q in effect.parameters.items()},
        "explains": explained,
    }
