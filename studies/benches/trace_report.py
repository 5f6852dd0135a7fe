"""The outcome of a trace of a bench, its page and its words."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from fabdesign.formats.json_file import plain
from fabdesign.formats.lab_table import DIMENSIONS
from fabdesign.formats.result_tables import Columns, Tabled
from fabdesign.nouns.array import Array
from fabdesign.nouns.bench import Bench
from fabdesign.nouns.model import EffectTerm
from fabdesign.units import in_kpa, in_mm
from studies.benches.records import BenchNoise, for_people, shown
from studies.benches.trace_fit import BenchCandidate
from studies.model_selection.verdict import STRUCTURE, Evidence, Word, effect_entry, effect_in_words, shared_out
from studies.report import charts, page

Curve = tuple[str, Array, Array, Array, Array]  # a record: its name, the rows' place, measured, before, after


@dataclass(frozen=True, eq=False)
class BenchOutcome(Tabled):
    """The outcome of a trace of a bench. Errors in the output's SI unit, RMS of records left out."""

    bench: Bench
    unit: str
    verdict: Word
    evidence: Evidence
    tolerance: float
    noise: BenchNoise
    candidates: tuple[BenchCandidate, ...]
    effects: tuple[EffectTerm, ...]
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
    def shares(self) -> dict[str, float]:
        """Return the share of the gap that each effect closes; of several, by what its absence costs."""
        return shared_out(self.evidence, self.gains)

    def columns(self) -> Columns:
        """Return a row a candidate: its name, error of records left out and gain."""
        names = {"name": [c.effect for c in self.candidates], "held_out": [c.held_out for c in self.candidates]}
        return {**names, "gain": [c.gain for c in self.candidates]}

    def json_content(self) -> dict[str, Any]:
        """Return `trace.json`."""
        added = self.verdict == "effect"
        crossed = (self.evidence.before, self.evidence.after)
        held_out = self.test or tuple(float(np.hypot(excess, self.floor)) for excess in crossed)
        none = BenchCandidate("none", 0.0, (0.0, 0.0), float(np.hypot(self.evidence.before, self.floor)), False)
        rows = [
            {"name": c.effect, "held_out": c.held_out, "gain": c.gain, "interval90": c.interval90,
             "adequate": c.held_out <= float(np.hypot(self.tolerance, self.floor))}
            for c in (none, *self.candidates)
        ]  # fmt: skip
        return {
            "format": "fabdesign.trace/1",
            "verdict": self.verdict,
            "effects": [effect_entry(e, self.shares.get(e.name)) for e in self.effects if added],
            "indistinguishable": self.indistinguishable if added else [],
            "candidates": sorted(rows, key=lambda row: float(str(row["held_out"]))),
            "error": {
                "metric": "rms",
                "unit": self.unit,
                **plain(self.noise),
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


def bench_in_words(outcome: BenchOutcome) -> str:
    """Return the answer in a sentence."""
    evidence = outcome.evidence
    before = shown(evidence.before, outcome.unit)
    if outcome.verdict == "adequate":
        return f"On records left out the quasi-static law leaves {before} over the noise. {_what_is_small(outcome)}"
    if outcome.verdict == "unexplained":
        if not outcome.effects:
            return f"On records left out {before} over the noise remain that none of the known effects explains."
        names = " and ".join(e.name.replace("_", " ") for e in outcome.effects)
        return (
            f"On records left out {before} over the noise remain; {names} would take a part, and "
            f"{shown(evidence.after, outcome.unit)} are left that none of the known effects explains."
        )
    named = " and ".join(effect_in_words(e) for e in outcome.effects)
    also = (
        f" These records cannot tell it from {', '.join(outcome.indistinguishable)}: that is one answer."
        if outcome.indistinguishable
        else ""
    )
    return f"Missing was {named}: {before} over the noise without, {shown(evidence.after, outcome.unit)} with it.{also}"


def _what_is_small(outcome: BenchOutcome) -> str:
    """Say of an adequate law whether an effect is certain all the same."""
    within = outcome.evidence.before <= outcome.tolerance
    limit = f"the tolerance of {shown(outcome.tolerance, outcome.unit)}"
    if (small := outcome.small) is None:
        return f"That is within {limit}." if within else "No effect is needed, and no baseline predicts the rest."
    gain, name = shown(small.gain, outcome.unit), small.effect.replace("_", " ")
    return (
        f"{name.capitalize()} gains {gain} of it for certain, but what is left is within {limit}, so it was not added; "
        "a smaller --tolerance judges it."
    )


def as_text(outcome: BenchOutcome) -> str:
    """Return the text for the terminal."""
    lines = [f"{outcome.verdict}: {bench_in_words(outcome)}"]
    scale, unit = for_people(outcome.unit)
    for c in outcome.candidates:
        gain = page.gain_in_words(scale * c.gain, [scale * v for v in c.interval90], unit, ".3g")
        sign = ", only with a sign that it cannot have" if c.refused else ""
        lines.append(f"  {c.effect:<18} gains {gain}{sign}")
    lines.append(f"the flexible baseline leaves {shown(outcome.evidence.box_before, outcome.unit)}")
    lines.append(outcome.noise.in_words(shown(outcome.floor, outcome.unit)))
    return "\n".join(lines)


def render_bench(outcome: BenchOutcome) -> str:
    """Return HTML, self-contained."""
    return page.html_of(outcome.bench.name, _blocks(outcome))


def _blocks(outcome: BenchOutcome) -> Iterator[page.Block]:
    scale, unit = for_people(outcome.unit)
    yield page.Title(f"{outcome.bench.name}: what its quasi-static law lacks", 1)
    yield page.Text(Markup("<b>{}.</b> {}").format(outcome.verdict.capitalize(), bench_in_words(outcome)), "verdict")
    yield from page.texts("quiet", [page.sentence(x) for x in (outcome.bench.description, outcome.bench.source) if x])
    yield charts.error_bars(outcome.to_json()["error"], "noise", unit, "RMS of records left out", scale)
    yield page.Title("Candidates")
    chosen = {effect.name for effect in outcome.effects}
    gains = [
        charts.Gain(c.effect + " (wrong sign)" * c.refused, c.gain, c.interval90, c.effect in chosen)
        for c in outcome.candidates
    ]
    yield charts.gains("candidates", gains, unit, "gain on records left out", outcome.tolerance, scale=scale)
    yield page.Text("Bold: in the model. At 0 there is no gain.", "quiet")
    yield page.Title("Records: measured, before, after")
    output = "displacement" if outcome.unit == "m" else outcome.bench.output
    styles = (("measured", charts.DARK), ("before", charts.RED), ("after", charts.BLUE))
    for k, (name, place, *lines) in enumerate(outcome.curves):
        by, x = _axis(outcome.bench, name)
        curves = [charts.curve(title, by * place, scale * y, c) for (title, c), y in zip(styles, lines, strict=True)]
        yield page.Title(name, 3)
        yield charts.chart(f"record-{k}", curves, x=x, y=f"{output}, {unit}", height=320)


def _axis(bench: Bench, record: str) -> tuple[float, str]:
    """Return what a record's curves lie over: a factor on its values in SI, and the axis' title with its unit."""
    columns = next(r.columns for r in bench.records if r.name == record)
    name = next((n for n in ("time", *bench.input) if n in columns), "row")
    unit = DIMENSIONS.get(name)
    factor, shown = {"time": (1.0, "s"), "pressure": (in_kpa(1.0), "kPa"), "length": (in_mm(1.0), "mm")}.get(
        unit or "", (1.0, "")
    )
    title = name.replace("_", " ")
    return factor, f"{title}, {shown}" if shown else title
