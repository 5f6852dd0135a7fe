"""The page and the words of a bench's trace."""

from collections.abc import Iterator

from markupsafe import Markup

from fabdesign.formats.lab_table import DIMENSIONS
from fabdesign.nouns.bench import Bench
from fabdesign.units import in_kpa, in_mm
from studies.benches.trace_outcome import BenchOutcome
from studies.report import charts, page
from studies.tracing.report import error_bars
from studies.tracing.statements import effect_in_words


def bench_in_words(outcome: BenchOutcome) -> str:
    """The answer in a sentence."""
    evidence = outcome.evidence
    before = _shown(evidence.before, outcome.unit)
    if outcome.verdict == "adequate":
        return f"On records left out the quasi-static law leaves {before} over the noise. {_what_is_small(outcome)}"
    if outcome.verdict == "unexplained":
        if not outcome.found:
            return f"On records left out {before} over the noise remain that none of the known effects explains."
        names, left = (
            " and ".join(e.name.replace("_", " ") for e in outcome.found),
            _shown(evidence.after, outcome.unit),
        )
        return (
            f"On records left out {before} over the noise remain; {names} would take a part, and {left} are left that "
            "none of the known effects explains."
        )
    named = " and ".join(effect_in_words(e) for e in outcome.found)
    also = (
        f" These records cannot tell it from {', '.join(outcome.indistinguishable)}: that is one answer."
        if outcome.indistinguishable
        else ""
    )
    return (
        f"Missing was {named}: {before} over the noise without, {_shown(evidence.after, outcome.unit)} with it.{also}"
    )


def _what_is_small(outcome: BenchOutcome) -> str:
    """Say of an adequate law whether an effect is certain all the same."""
    within = outcome.evidence.before <= outcome.tolerance
    limit = f"the tolerance of {_shown(outcome.tolerance, outcome.unit)}"
    if (small := outcome.small) is None:
        return f"That is within {limit}." if within else "No effect is needed, and no baseline predicts the rest."
    gain, name = _shown(small.gain, outcome.unit), small.effect.replace("_", " ")
    return (
        f"{name.capitalize()} gains {gain} of it for certain, but what is left is within {limit}, so it was not added; "
        "a smaller --tolerance judges it."
    )


def as_text(outcome: BenchOutcome) -> str:
    """For the terminal."""
    lines = [f"{outcome.verdict}: {bench_in_words(outcome)}"]
    for c in outcome.candidates:
        scale, unit = (in_mm(1.0), "mm") if outcome.unit == "m" else (1.0, outcome.unit)
        gain = page.gain_in_words(scale * c.gain, [scale * v for v in c.interval90], unit, ".3g")
        sign = ", only with a sign that it cannot have" if c.refused else ""
        lines.append(f"  {c.effect:<18} gains {gain}{sign}")
    lines.append(f"the flexible baseline leaves {_shown(outcome.evidence.box_before, outcome.unit)}")
    lines.append(outcome.noise.in_words(_shown(outcome.floor, outcome.unit)))
    return "\n".join(lines)


def _shown(value: float, unit: str) -> str:
    return f"{in_mm(value):.3g} mm" if unit == "m" else f"{value:.3g} {unit}"


def render_bench(outcome: BenchOutcome) -> str:
    """Return HTML, self-contained."""
    return page.html_of(outcome.bench.name, _blocks(outcome))


def _blocks(outcome: BenchOutcome) -> Iterator[page.Block]:
    scale, unit = (in_mm(1.0), "mm") if outcome.unit == "m" else (1.0, outcome.unit)
    yield page.Title(f"{outcome.bench.name}: what its quasi-static law lacks", 1)
    yield page.Text(Markup("<b>{}.</b> {}").format(outcome.verdict.capitalize(), bench_in_words(outcome)), "verdict")
    yield from page.texts("quiet", [page.sentence(x) for x in (outcome.bench.description, outcome.bench.source) if x])
    yield error_bars(outcome.as_json()["error"], "noise", unit, "RMS of records left out", scale)
    yield page.Title("Candidates")
    chosen = {effect.name for effect in outcome.found}
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
