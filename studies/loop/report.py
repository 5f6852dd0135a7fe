"""The page that shows a loop: errors on the device turn by turn, beside what each search predicted."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from fabdesign.design_file import read_design
from fabdesign.layout_drawing import layout_svg
from fabdesign.loop_file import LoopStudy
from fabdesign.output import write_text
from fabdesign.pressure_file import read_pressures
from studies.layouts.figures import SHOWN, TARGET, faces_trace, points_trace
from studies.layouts.target import LoadedTarget
from studies.loop.record import LoopOutcome, Turn
from studies.report import PlotlyFigure, html_of, scene_layout

PREDICTED, DEVICE = "#92c5de", "#b2182b"
_BAR, _GAP, _WIDE = 16, 26, 420  # of a drawing unit


def write_report(
    outcome: LoopOutcome, study: LoopStudy, targets: Sequence[LoadedTarget], folder: Path, out: Path
) -> None:
    """Write `report.html` into `out`; the turns' folders lie in `folder`."""
    measured = [turn for turn in outcome.turns if turn.device is not None]
    figures = {turn.name: _scene(turn, targets, folder) for turn in measured}
    page = html_of(
        "loop/report.html.j2",
        figures=figures,
        outcome=outcome,
        sentence=as_sentence(outcome),
        targets=[target.description for target in targets],
        bars=Markup(_bars(outcome.turns)),
        layouts={turn.name: Markup(_layout(turn, study, folder)) for turn in outcome.turns},
        scenes=[*figures],
    )
    write_text(out / "report.html", page)


def as_sentence(outcome: LoopOutcome) -> str:
    """Where the loop stands."""
    measured = [turn.device["excess"] for turn in outcome.turns if turn.device is not None]
    best = outcome.best
    if best is None or best.device is None:
        return f"A design is chosen. Its measurements are expected in {outcome.waiting_for}."
    said = f"The first design is {measured[0]:.2f} mm over the noise floor on the device"
    if len(measured) > 1:
        said += f"; the nearest, {best.name.replace('_', ' ')}, is {best.device['excess']:.2f} mm over it"
    if outcome.waiting_for is not None:
        return f"{said}. The next measurements are expected in {outcome.waiting_for}."
    return f"{said}. Ended: {outcome.stop_reason}."


def as_text(outcome: LoopOutcome) -> str:
    """For the terminal: a line a turn, and what comes next."""
    lines, device = [], "on the device (synthetic rig)" if outcome.synthetic else "on the device"
    for turn in outcome.turns:
        predicted = f"predicted {turn.chosen['believed']['excess']:.2f} mm"
        on = "not measured yet" if turn.device is None else f"{device} {turn.device['excess']:.2f} mm"
        lines.append(f"{turn.name.replace('_', ' ')}: {predicted}, {on} over the noise floor")
        lines += [f"  {line}" for line in (turn.learned["said"] if turn.learned else ())]
    if outcome.waiting_for is not None:
        lines.append(
            f"waiting for a measurement set in {outcome.waiting_for}; what to sew and to run: {outcome.asked}; then "
            "run the same command again"
        )
    else:
        lines.append(f"ended: {outcome.stop_reason}")
    return "\n".join(lines)


def _bars(turns: Sequence[Turn]) -> str:
    """Excess of each turn, predicted and measured, as an SVG."""
    pairs = [(t.name, t.chosen["believed"]["excess"], None if t.device is None else t.device["excess"]) for t in turns]
    most = max([0.1, *(value for _, *values in pairs for value in values if value is not None)])
    parts, y = [], 4
    for name, *values in pairs:
        parts.append(f'<text x="0" y="{y + _BAR}">{name.replace("_", " ")}</text>')
        for value, colour, what in zip(values, (PREDICTED, DEVICE), ("predicted", "device"), strict=True):
            if value is not None:
                parts.append(
                    f'<rect x="60" y="{y}" width="{_WIDE * value / most:.1f}" height="{_BAR}" fill="{colour}"/>'
                )
                text = f"{what} {value:.2f} mm"
                parts.append(f'<text x="{66 + _WIDE * value / most:.1f}" y="{y + _BAR - 4}">{text}</text>')
            y += _BAR + 2
        y += _GAP - _BAR
    return f'<svg viewBox="0 0 {_WIDE + 190} {y}" class="bars" role="img" aria-label="excess">{"".join(parts)}</svg>'


def _layout(turn: Turn, study: LoopStudy, folder: Path) -> str:
    search = folder / turn.name / "search"
    design = read_design(search / "design.toml")
    pressures = read_pressures(search / "pressures.csv", design).pressure[-1]
    return layout_svg(design, pressures, study.search.limits.pressure[1])


def _scene(turn: Turn, targets: Sequence[LoadedTarget], folder: Path) -> PlotlyFigure:
    """Of the first pose: the target, the measured cloth, and the shape that the search predicted."""
    with np.load(folder / turn.name / "shapes.npz") as arrays:
        shapes = {name: np.asarray(arrays[name][0], dtype=float) for name in ("device", "believed")}
    target = targets[0].points
    traces = [
        points_trace(target[:: max(1, len(target) // SHOWN)], "target", TARGET),
        faces_trace(shapes["device"]) | {"name": "measured", "color": DEVICE, "opacity": 0.7},
        faces_trace(shapes["believed"]) | {"name": "predicted", "color": PREDICTED, "opacity": 0.7},
    ]
    return {"data": traces, "layout": scene_layout(traces)}
