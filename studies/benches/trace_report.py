"""The outcome of a trace of a bench, its page and its words."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from markupsafe import Markup

from fabdesign.effects import EFFECTS
from fabdesign.formats.lab_table import DIMENSIONS
from fabdesign.formats.result_tables import Columns
from fabdesign.nouns.array import Array, Indices
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.model import EffectTerm, Model, Provenance
from fabdesign.nouns.trial import Role
from fabdesign.runtime.fingerprint import sha256
from fabdesign.units import in_kpa, in_mm
from fabdesign.version import __version__
from studies.benches.evaluate import METRIC
from studies.benches.records import LAWS, BenchNoise, for_people, output_of, shown
from studies.model_selection.outcome import Candidate, TraceOutcome, When
from studies.model_selection.verdict import STRUCTURE, effect_in_words
from studies.report import charts, page

Curve = tuple[BenchRecord, Indices, Array, Array]  # a record, rows of it, what is left of these before and after
AXES = {"time": (1.0, "s"), "pressure": (in_kpa(1.0), "kPa"), "length": (in_mm(1.0), "mm")}  # by dimension


@dataclass(frozen=True, eq=False)
class BenchOutcome(TraceOutcome):
    """The outcome of a trace of a bench. Errors in the output's SI unit, RMS of records left out."""

    metric: ClassVar = METRIC

    bench: Bench
    noise: BenchNoise
    effects: tuple[EffectTerm, ...]  # that were certain, also where they do not explain what is missing
    fit: tuple[float, float]  # before, after
    test: tuple[float, float] | None  # the same on records of role test, looked at once; None without any
    curves: tuple[Curve, ...]
    json_keys: ClassVar = (
        *TraceOutcome.json_keys,
        ("error.noise_from", "noise.source"),
        ("within_tolerance", lambda of: [of.small.name] if of.small else []),
        ("residual", lambda of: {"where": None, "when_s": None, "follows": None}),
        ("unjudged", lambda of: []), ("discovered", lambda of: None), ("next_experiment", lambda of: None),
    )  # fmt: skip

    @property
    def unit(self) -> str:
        """Return the output's SI unit."""
        return LAWS[self.bench.specimen].unit

    def mean_error(self, role: Role, when: When) -> float | None:
        """Return the mean error of records of a role; None where there are none."""
        errors = self.fit if role == "fit" else self.test
        return errors and errors[when == "after" and self.verdict == "effect"]

    @property
    def model(self) -> Model:
        """Return the model with those of the effects that the simulator has, where its parameters mean the same."""
        return Model(
            effects=tuple(
                effect
                for effect in self.named.values()
                if all(
                    (declared := EFFECTS[effect.name].parameters.get(name)) is not None
                    and declared.unit == quantity.unit
                    and declared.bounds[0] <= quantity.value <= declared.bounds[1]
                    for name, quantity in effect.parameters.items()
                )
            ),
            provenance=Provenance(
                sets=(self.bench.name,),
                fitted=tuple(f"{self.bench.name}/{r.name}" for r in self.bench.of_role("fit")),
                versions={"fabdesign": __version__},
                hashes={f"{self.bench.name}/bench.toml": sha256(self.bench.file)},
            ),
        )

    @property
    def small(self) -> Candidate | None:
        """Return, where the law is adequate within the tolerance, the candidate that takes most of what is left, if it
        gains for certain and more than a reading's noise."""
        if self.verdict != "adequate" or not self.candidates:
            return None
        best = self.candidates[0]
        structure = best.gain**2 >= (1 - (1 - STRUCTURE) ** 2) * self.evidence.before**2
        certain = best.interval90[0] > 0 and best.gain > self.floor
        return best if certain and structure and not best.refused else None

    def columns(self) -> Columns:
        """Return a row a candidate: its name, error of records left out and gain."""
        rows = self.rows[1:]
        return {key: [getattr(row, key) for row in rows] for key in ("name", "held_out", "gain")}


def bench_in_words(outcome: BenchOutcome) -> str:
    """Return the answer in a sentence."""
    evidence = outcome.evidence
    before = shown(evidence.before, outcome.unit)
    if outcome.verdict == "adequate":
        leaves = f"On records left out the quasi-static law leaves {before} over the noise."
        limit = f"within the tolerance of {shown(outcome.tolerance, outcome.unit)}"
        if (small := outcome.small) is None:
            return f"{leaves} That is {limit}."
        return (
            f"{leaves} {small.name.replace('_', ' ').capitalize()} gains {shown(small.gain, outcome.unit)} of it for "
            f"certain, but what is left is {limit}, so it was not added; a smaller --tolerance judges it."
        )
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


def as_text(outcome: BenchOutcome) -> str:
    """Return the text for the terminal."""
    lines = [f"{outcome.verdict}: {bench_in_words(outcome)}"]
    scale, unit = for_people(outcome.unit)
    for c in outcome.candidates:
        gain = page.gain_in_words(scale * c.gain, [scale * v for v in c.interval90], unit, ".3g")
        sign = ", only with a sign that it cannot have" if c.refused else ""
        lines.append(f"  {c.name:<18} gains {gain}{sign}")
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
    yield charts.error_bars(outcome.compared, "noise", unit, "RMS of records left out", scale)
    yield page.Title("Candidates")
    gains = [(c.name + " (wrong sign)" * c.refused, c.gain, c.interval90, c.chosen) for c in outcome.candidates]
    yield charts.gains("candidates", gains, unit, "gain on records left out", outcome.tolerance, scale=scale)
    yield page.Text("Bold: in the model. At 0 there is no gain.", "quiet")
    yield page.Title("Records: measured, before, after")
    output = "displacement" if outcome.unit == "m" else outcome.bench.output
    styles = (("measured", charts.DARK), ("before", charts.RED), ("after", charts.BLUE))
    for k, (record, rows, *misses) in enumerate(outcome.curves):
        name = next((n for n in ("time", *outcome.bench.input) if n in record.columns), "row")
        place = np.arange(len(rows), dtype=float) if name == "row" else record.columns[name][rows]
        by, shown_in = AXES.get(DIMENSIONS.get(name, ""), (1.0, ""))
        measured = record.columns[output_of(outcome.bench)][rows]
        lines = measured, *(measured + miss for miss in misses)
        curves = [charts.curve(title, by * place, scale * y, c) for (title, c), y in zip(styles, lines, strict=True)]
        yield page.Title(record.name, 3)
        x = ", ".join(filter(None, (name.replace("_", " "), shown_in)))
        yield charts.chart(f"record-{k}", curves, x=x, y=f"{output}, {unit}", height=320)
