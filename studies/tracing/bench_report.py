"""The page and the words of a bench's trace."""

from fabdesign.units import in_mm
from studies.report import PlotlyFigure, html_of
from studies.tracing.bench_outcome import BenchOutcome
from studies.tracing.words import effect_in_words


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
        f" These records cannot tell it from {', '.join(outcome.indistinguishable)}."
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
        gain, low, high = (_shown(v, outcome.unit) for v in (c.gain, *c.interval90))
        sign = ", only with a sign that it cannot have" if c.refused else ""
        lines.append(f"  {c.effect:<18} gains {gain} (90 % {low} to {high}){sign}")
    lines.append(f"the flexible baseline leaves {_shown(outcome.evidence.box_before, outcome.unit)}")
    lines.append(outcome.noise.in_words(_shown(outcome.floor, outcome.unit)))
    return "\n".join(lines)


def _shown(value: float, unit: str) -> str:
    return f"{in_mm(value):.3g} mm" if unit == "m" else f"{value:.3g} {unit}"


def render_bench(outcome: BenchOutcome) -> str:
    """HTML, self-contained."""
    error = outcome.as_json()["error"]
    bars = {"noise": error["noise_floor"], "flexible baseline": error["ceiling"], "after": error["after"]["held_out"],
            "before": error["before"]["held_out"]}  # fmt: skip
    names = [c.effect + (" (wrong sign)" if c.refused else "") for c in outcome.candidates]
    figures: dict[str, PlotlyFigure] = {
        "bars": {
            "data": [{"type": "bar", "orientation": "h", "y": [*bars], "x": [*bars.values()]}],
            "layout": {"xaxis": {"title": f"RMS of records left out, {outcome.unit}"}},
        },
        "candidates": {
            "data": [{"type": "scatter", "mode": "markers", "y": names,
                      "x": [c.gain for c in outcome.candidates],
                      "error_x": {"type": "data", "symmetric": False,
                                  "array": [max(c.interval90[1] - c.gain, 0) for c in outcome.candidates],
                                  "arrayminus": [max(c.gain - c.interval90[0], 0) for c in outcome.candidates]}}],
            "layout": {"xaxis": {"title": f"gain, {outcome.unit}"}, "margin": {"l": 150}},
        },
    }  # fmt: skip
    records = []
    for k, (name, place, *lines) in enumerate(outcome.curves):
        data = [
            {"type": "scatter", "mode": "lines", "name": title, "x": place.tolist(), "y": line.tolist()}
            for title, line in zip(("measured", "before", "after"), lines, strict=True)
        ]
        figures[f"record-{k}"] = {"data": data, "layout": {"title": name}}
        records.append(f"record-{k}")
    return html_of(
        "tracing/bench_report.html.j2",
        figures=figures,
        name=outcome.bench.name,
        verdict=outcome.verdict,
        words=bench_in_words(outcome),
        source=f"{outcome.bench.description}. {outcome.bench.source}",
        records=records,
    )
