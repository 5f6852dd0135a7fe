"""What a trace of a bench came to."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fabdesign.formats.json_file import plain
from fabdesign.formats.result_tables import Columns, Tabled
from fabdesign.nouns.bench import Bench
from fabdesign.nouns.model import EffectTerm
from optimize.fit.misfit import Array
from studies.benches.noise import BenchNoise
from studies.benches.trace_fit import BenchCandidate
from studies.tracing.verdict import STRUCTURE, Evidence, Word, effect_entry, shared_out

Curve = tuple[str, Array, Array, Array, Array]  # a record: its name, the rows' place, measured, before, after


@dataclass(frozen=True, eq=False)
class BenchOutcome(Tabled):
    """Of a trace of a bench. Errors in the output's SI unit, RMS of records left out."""

    bench: Bench
    unit: str
    verdict: Word
    evidence: Evidence
    tolerance: float
    noise: BenchNoise
    candidates: tuple[BenchCandidate, ...]
    found: tuple[EffectTerm, ...]
    gains: Mapping[str, float]  # by effect, of those chosen
    indistinguishable: tuple[str, ...]
    fit: tuple[float, float]  # before, after
    test: tuple[float, float] | None  # the same on records of role test, looked at once; None without any
    curves: tuple[Curve, ...]

    @property
    def floor(self) -> float:
        """Return the noise of a reading; 0 where the records do not show it."""
        return self.noise.sigma

    @property
    def small(self) -> BenchCandidate | None:
        """Return, where the law is adequate within the tolerance, the candidate that takes most of what is left, if it
        gains for certain and more than a reading's noise."""
        if self.verdict != "adequate" or not self.candidates:
            return None
        best = self.candidates[0]
        structure = best.gain**2 >= (1 - (1 - STRUCTURE) ** 2) * self.evidence.before**2
        certain = best.interval90[0] > 0 and best.gain > self.floor
        return best if certain and structure and not best.refused else None

    @property
    def refused(self) -> tuple[str, ...]:
        """Candidates that would explain some, but only with a sign that they cannot have."""
        return tuple(c.effect for c in self.candidates if c.refused)

    @property
    def shares(self) -> dict[str, float]:
        """Of the gap, what each effect closes; of several, by what its absence costs."""
        return shared_out(self.evidence, self.gains)

    def columns(self) -> Columns:
        """Return a row a candidate: its name, error of records left out and gain."""
        names = {"name": [c.effect for c in self.candidates], "held_out": [c.held_out for c in self.candidates]}
        return {**names, "gain": [c.gain for c in self.candidates]}

    def as_json(self) -> dict[str, Any]:
        """`trace.json`."""
        added = self.verdict == "effect"
        crossed = (self.evidence.before, self.evidence.after)
        held_out = self.test or tuple(float(np.hypot(excess, self.floor)) for excess in crossed)
        none = BenchCandidate("none", 0.0, (0.0, 0.0), float(np.hypot(self.evidence.before, self.floor)), False)
        rows = [
            {"name": c.effect, "held_out": c.held_out, "gain": c.gain, "interval90": c.interval90,
             "adequate": c.held_out <= float(np.hypot(self.tolerance, self.floor))}
            for c in (none, *self.candidates)
        ]  # fmt: skip
        trace = {
            "format": "fabdesign.trace/1",
            "verdict": self.verdict,
            "effects": [effect_entry(e, self.shares.get(e.name)) for e in self.found if added],
            "indistinguishable": self.indistinguishable if added else [],
            "candidates": sorted(rows, key=lambda row: float(str(row["held_out"]))),
            "error": {
                "metric": "rms",
                "unit": self.unit,
                "noise_floor": self.floor,
                "noise_from": self.noise.source,
                "tolerance": self.tolerance,
                "ceiling": float(np.hypot(self.evidence.box_before, self.floor)),
                "before": {"fit": self.fit[0], "held_out": held_out[0]},
                "after": {"fit": self.fit[added], "held_out": held_out[added]},
            },
            "within_tolerance": [self.small.effect] if self.small else [],
            "residual": {"where": None, "when_s": None, "follows": None},
            "unjudged": [],
            "discovered": None,
            "next_experiment": None,
        }
        return dict(plain(trace))
