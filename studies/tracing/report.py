"""The page that says what a trace found: self-contained, for any browser, without a network."""

from typing import Any

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.model import Model
from fabdesign.motion_file import square_triangles
from fabdesign.units import in_mm
from studies.report import (
    BLUE,
    GREY,
    RED,
    Gain,
    PlotlyFigure,
    bars_chart,
    chart,
    gain_in_words,
    gains_chart,
    html_of,
    line,
)
from studies.tracing.outcome import Outcome
from studies.tracing.residual import remains
from studies.tracing.residuals import Residuals
from studies.tracing.words import experiment_in_words, verdict_in_words
from studies.used_frames import WHY
from studies.view.items import Item
from studies.view.page import render_page

_FRAMES = 45  # of the motion shown


def render_report(outcome: Outcome) -> str:
    """HTML."""
    before = remains(Residuals.of(outcome.data, outcome.before), outcome.selection.folds)
    most = float(np.nanmax([before.cells, outcome.remains.cells]))
    figures = {
        "bars": _bars(outcome),
        "candidates": _candidates(outcome),
        "cloth-before": _cloth(outcome, before.cells, "before", most),
        "cloth-after": _cloth(outcome, outcome.remains.cells, "after", most),
        "time": _over_time(outcome, before.over_time),
    }
    if outcome.next_experiment is not None:
        figures["program"] = _program(outcome)
    return html_of(
        "tracing/report.html.j2",
        figures=figures,
        outcome=outcome,
        gain=lambda row: gain_in_words(row["gain"], row["interval90"], ""),
        result=outcome.as_json(),
        verdict=verdict_in_words(outcome),
        experiment=experiment_in_words(outcome),
        why=WHY,
        shown=_worst(outcome),
        has_tests=any(e.role == "test" for e in outcome.errors),
        motion=_motion(outcome),
        parameters=_parameter_rows(outcome.model),
        signature={name: EFFECTS[name].signature for name in EFFECTS},
        units={e.name: {n: "" if p.unit == "1" else p.unit for n, p in e.parameters.items()} for e in EFFECTS.values()},
    )


def _bars(outcome: Outcome) -> PlotlyFigure:
    error = outcome.as_json()["error"]
    rows = [
        ("noise floor", error["noise_floor"], GREY),
        ("flexible baseline", error["ceiling"], GREY),
        ("after", error["after"]["held_out"], BLUE),
        ("before", error["before"]["held_out"], RED),
    ]
    return bars_chart(rows, "mm", "surface RMS of trials held out")


def _candidates(outcome: Outcome) -> PlotlyFigure:
    gains = [
        Gain(c.name, in_mm(c.gain), (in_mm(c.interval90[0]), in_mm(c.interval90[1])), c.chosen)
        for c in outcome.candidates
    ]
    return gains_chart(gains, "mm", "gain of held-out excess", in_mm(outcome.tolerance))


def _cloth(outcome: Outcome, cells: np.ndarray, title: str, most: float) -> PlotlyFigure:
    """Return the residual's RMS by places. most: m, of the colours, alike before and after so that they compare."""
    fabric = outcome.data.trials[0].design.fabric
    n = len(cells)
    centres = (np.arange(n) + 0.5) / n
    heat = {
        "type": "heatmap", "z": [[None if np.isnan(v) else in_mm(v) for v in row] for row in cells.tolist()],
        "x": (in_mm(fabric.width) * centres).tolist(), "y": (in_mm(fabric.height) * centres).tolist(),
        "colorscale": "Viridis", "zmin": 0, "zmax": in_mm(most),
        "colorbar": {"title": {"text": "RMS, mm"}, "thickness": 12},
    }  # fmt: skip
    down = {"autorange": "reversed", "scaleanchor": "x", "constrain": "domain"}
    across = {"constrain": "domain"}
    above = {"text": title, "x": 0.5, "y": 0.98, "yanchor": "top"}
    margin = {"l": 10, "r": 10, "t": 45, "b": 10}
    return chart([heat], x="u, mm", y="v, mm", title=above, xaxis=across, yaxis=down, margin=margin, height=400)


def _over_time(outcome: Outcome, before: dict[str, Any]) -> PlotlyFigure:
    lines = []
    for which, table, colour in (("before", before, RED), ("after", outcome.remains.over_time, BLUE)):
        for k, (name, (times, rms)) in enumerate(table.items()):
            shown = f"{name} {which}: %{{y:.2f}} mm at %{{x:.2f}} s<extra></extra>"
            group = {"legendgroup": which, "showlegend": k == 0, "hovertemplate": shown, "line": {"width": 1}}
            lines.append(line(which, times.tolist(), in_mm(rms).tolist(), colour, **group))
    return chart(lines, x="time, s", y="RMS, mm", yaxis={"rangemode": "tozero"})


def _program(outcome: Outcome) -> PlotlyFigure:
    assert outcome.next_experiment is not None
    program = outcome.next_experiment["program"]
    times = [*program["time_s"], program["duration_s"]]
    rows = [*program["pressure_kpa"], program["pressure_kpa"][-1]]
    lines = [line(f"channel {c}", times, [row[c] for row in rows], line={"shape": "hv"}) for c in range(len(rows[0]))]
    return chart(lines, x="time, s", y="pressure, kPa")


def _worst(outcome: Outcome) -> str:
    """The trial of role fit whose error was largest before."""
    own = [e for e in outcome.errors if e.role == "fit" and np.isfinite(e.before.surface_rms)]
    return max(own, key=lambda e: e.before.surface_rms).trial


def _motion(outcome: Outcome) -> str:
    name = _worst(outcome)
    trial = next(trial for trial in outcome.data.trials if trial.name == name)
    frames = np.unique(np.linspace(0, len(trial.times) - 1, min(_FRAMES, len(trial.times))).round().astype(int))
    times, clouds = trial.times[frames], trial.load().frames
    fits = outcome.before, outcome.after
    motions = outcome.forward.motions([found.vector.case(trial, found.x) for found in fits], [times, times])
    items = [Item(f"measured, {name}", times, [clouds[int(k)] for k in frames])]
    for title, motion in zip(("before", "after"), motions, strict=True):
        if np.isfinite(motion).all():
            items.append(Item(title, times, motion, square_triangles(motion.shape[1])))
    return render_page(f"{outcome.name}/{name}", items)


def _parameter_rows(model: Model) -> list[tuple[str, str, str]]:
    """Name, before, after."""

    def cell(parameter: Any) -> str:
        factor = f"{parameter.factor:.3f}"
        if parameter.interval90 is None or not np.isfinite(parameter.interval90).all():
            return factor
        return "{} ({:.2f} to {:.2f})".format(factor, *parameter.interval90)

    plain = model.without_effects or model.parameters
    return [(name, cell(plain[name]), cell(model.parameters[name])) for name in model.parameters]
