"""The page of a study of what is not measured yet, and its words."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from fabdesign.formats.toml_file import file_stem
from fabdesign.units import in_mm
from fabdesign.version import __version__
from studies.prediction.evaluation_report import ERROR_NAMES, draw_bars
from studies.report import page
from studies.study import write_result
from studies.unseen.result import Measurement, PoseResult, UnseenResult, UnsewnResult

_STATISTICS = ("mean", "max", "min", "std")
_SNAPS = "Near a bifurcation: the cloth may buckle to either side. Pressures 2 % off lead to another stable shape."
_MEASURED = Markup("""To first order about the model, the shapes are spread by {:.2f} mm RMS. The table says how much of
this spread each measurement would leave. It assumes 1 mm a coordinate for noise and model error, and 40 independent
points of a frame. The set points of the first program are in result.json, <code>measurement.program</code>.""")


def write_report(result: UnseenResult, out: Path, *, pictures: Path) -> None:
    """Write `result.json` and `report.html` into `out`; `pictures` holds the overlays."""
    ended = f"seed {result.seed}, {result.wall_s:.0f} s. fabdesign {__version__}"
    last = page.Text(f"{result.points_per_side} grid points a side, {ended}.", "quiet")
    blocks = [page.Title(result.name, 1), *_shapes(result), *_left_out(result, pictures), last]
    write_result(out, result, result.name, blocks)


def _shapes(result: UnseenResult) -> Iterator[page.Block]:
    """Yield the shapes of a layout before it is sewn, and what to measure."""
    if (unsewn := result.unsewn) is None:
        return
    sentence = page.sentence(unsewn.corrector.sentence)
    yield page.Text(f"""Design {unsewn.design}, before it is sewn: shapes at rest of models drawn from the model's
        joint covariance. {sentence}""")
    yield from page.texts("note", map(page.sentence, _notes(unsewn, result.points_per_side)))
    yield page.Columns([[*_pose(pose)] for pose in unsewn.poses or []], "faces")
    if unsewn.measurement is not None:
        yield from _measurement(unsewn.measurement)


def _pose(pose: PoseResult) -> Iterator[page.Block]:
    yield page.Title(f"{', '.join(f'{p:g}' for p in pose.pressures_kpa)} kPa")
    yield page.Picture(_band_figure(pose))
    if pose.snaps:
        yield page.Text(_SNAPS, "note")
    values = {f"lower edge {axis}, mm": pose.tip_mm[axis] for axis in "xyz"}
    values |= {f"{name}, {output.unit}": output.percentiles for name, output in pose.outputs.items()}
    rows = [(name, *(f"{round(x, 1) + 0:.1f}" for x in row)) for name, row in values.items()]
    yield page.TableBlock(("", "5 %", "middle", "95 %"), [*rows, ("mean curvature, 1/m", *pose.mean_curvature)])
    failed = f" {pose.failed} models found no shape at rest." if pose.failed else ""
    yield page.Text(f"""A drawn shape lies {pose.band_mm:.2f} mm RMS from the mean shape, {pose.widest_mm:.2f} mm
        where the scatter is widest.{failed}""")


def _measurement(measurement: Measurement) -> Iterator[page.Block]:
    yield page.Title("What to measure")
    yield page.Text(_MEASURED.format(measurement.spread_mm))
    rows = [(name, c.design, c.remaining_mm) for name, c in measurement.candidates.items()]
    yield page.TableBlock(("program", "on", "left, mm"), rows, left_aligned=(1,))
    in_turn = ", ".join(f"{name} (leaves {remaining:.2f} mm)" for name, remaining in measurement.in_turn_mm.items())
    yield page.Text(f"Measured one after another, each telling most beside those before it: {in_turn}.")
    head = "unknown, in the covariance's order", "spread by its own part, mm"
    yield page.TableBlock(head, [*measurement.due_to_mm.items()])


def _left_out(result: UnseenResult, pictures: Path) -> Iterator[page.Block]:
    """Yield each design as those of the others predict it."""
    if not (left_out := result.left_out):
        return
    done = {name: entry for name, entry in left_out.items() if entry}
    yield page.Title("Each design left out in turn")
    free = ", ".join(result.free or ())
    states = f" Without effects: factors fitted alone. After: factors and effects ({free}) fitted together."
    yield page.Text(f"""The model is calibrated on the trials of the other designs and evaluated on the design left out.
        Before: the data sheet.{states if free else ""} Values in mm over trials.""")
    if waiting := ", ".join(name for name in left_out if name not in done):
        why = "Not started, because the time was used"
        yield page.Text(f"{why}: {waiting}. The same command with more seconds goes on.", "note")
    head = "left out", "error", "", *_STATISTICS, "noise floor", "excess removed"
    yield page.TableBlock(
        head, [row for name, entry in done.items() for row in _error_rows(name, entry)], left_aligned=(1, 2)
    )
    for name, entry in done.items():
        yield page.Title(name)
        bent = f", without {100 * entry['share_unjudged']:.0f} % of their frames, which are near a bifurcation"
        used = f"{len(entry['trials'])} evaluated{bent if entry['share_unjudged'] else ''}."
        reasons = f" The intervals are not reliable: {'; '.join(entry['doubts'])}." if entry["doubts"] else ""
        yield page.Text(f"{entry['source']}. {entry['fitted']} trials of the others fitted, {used}{reasons}", "quiet")
        if entry["effects"]:
            yield page.TableBlock(("effect", "value", "90 %", ""), _effect_rows(entry["effects"]))
        yield page.Picture(_histogram_figure(entry))
        overlay = (pictures / f"left_out_{file_stem(name)}.png").read_bytes()
        yield page.Picture(overlay, f"{name}, measured over model")


def _error_rows(name: str, entry: dict[str, Any]) -> Iterator[tuple[object, ...]]:
    """Yield a row for each error and state of a design left out, mm."""
    for kind, error, word in (("chamfer", "chamfer", "Chamfer"), ("surface", "surface_rms", "surface RMS")):
        share = entry["closed"][kind]
        for state in ("before", "without_effects", "after"):
            if values := entry.get(state):
                removed = "" if state != "after" or share is None else f"{100 * share:.0f} %"
                statistics = [values[error][key] for key in _STATISTICS]
                yield name, word, state.replace("_", " "), *statistics, values[f"{kind}_floor"]["mean"], removed


def _effect_rows(effects: list[dict[str, Any]]) -> list[tuple[str, str, str, str]]:
    """Return name, value, interval, unit of every parameter."""
    return [
        (
            f"{effect['name']}.{name}".replace("_", " "),
            f"{p['value']:.4g}",
            "held" if p["interval90"] is None else page.interval(p["interval90"], ".4g"),
            "" if p["unit"] == "1" else p["unit"],
        )
        for effect in effects
        for name, p in effect["parameters"].items()
    ]


def _notes(unsewn: UnsewnResult, grid: int) -> list[str]:
    """Return what must be said beside the shapes' intervals."""
    notes, fitted_grid = [unsewn.intervals], unsewn.model_points_per_side
    if unsewn.doubted and not unsewn.calibrated:
        notes.append(
            f"the model's intervals of {', '.join(unsewn.doubted)} are not reliable: its fit left more than "
            "noise. The intervals here follow from them and are probably too narrow"
        )
    if fitted_grid != grid:
        notes.append(f"the model's factors belong to a grid of {fitted_grid} points a side; these shapes have {grid}")
    if unsewn.unknown:
        unknown = ", ".join(unsewn.unknown)
        notes.append(
            f"the model has no data on {unknown}: the tolerance of the data sheet is used (15 %). A bench reduces it"
        )
    return notes


def _band_figure(pose: PoseResult) -> Figure:
    """Return the cloth's middle line from the side: of every drawn model, and their mean."""
    lines = in_mm(np.array(pose.middle))
    figure = Figure(figsize=(4.2, 4.2), layout="constrained")
    axes = figure.subplots()
    for line in lines:
        axes.plot(line[:, 0], line[:, 1], color="#92c5de", linewidth=0.6)
    axes.plot([], [], color="#92c5de", label="models drawn")
    axes.plot(*lines.mean(axis=0).T, color="#1c2430", linewidth=1.4, label="their mean")
    axes.legend(fontsize="small", frameon=False, loc="lower left", bbox_to_anchor=(0, 1))
    axes.set(xlabel="z, mm (front)", ylabel="y, mm", aspect="equal")
    return figure


def _histogram_figure(sizes: dict[str, Any]) -> Figure:
    figure = Figure(figsize=(7, 2.8), layout="constrained")
    for axes, error in zip(figure.subplots(1, 2), ("chamfer", "surface_rms"), strict=True):
        draw_bars(axes, sizes["histogram"][error], {"before": "#9aa5b1", "after": "#2166ac"})
        axes.set_xlabel(f"{ERROR_NAMES[error]}, mm")
        axes.legend(fontsize="small", frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0, 1))
    return figure


def as_text(result: UnseenResult) -> str:
    """Return the result in words."""
    lines, unsewn = [], result.unsewn
    for pose in (unsewn and unsewn.poses) or ():
        low, middle, high = pose.tip_mm["z"]
        shown = ", ".join(f"{p:g}" for p in pose.pressures_kpa)
        snaps = "; may buckle to either side" if pose.snaps else ""
        lines.append(
            f"{shown} kPa: lower edge at z = {middle:.1f} mm (90 % {low:.1f} to {high:.1f}), "
            f"shape within {pose.band_mm:.2f} mm RMS{snaps}"
        )
        for name, output in pose.outputs.items():
            low, middle, high = output.percentiles
            lines.append(f"  {name}: {middle:.1f} {output.unit} (90 % {low:.1f} to {high:.1f})")
    if unsewn is not None:
        lines += [unsewn.corrector.sentence, *_notes(unsewn, result.points_per_side)]
    if unsewn is not None and unsewn.measurement is not None and unsewn.measurement.candidates:
        measurement = unsewn.measurement
        name, best = next(iter(measurement.candidates.items()))
        lines.append(
            f"the best measurement: {name}, on {best.design}; it reduces {measurement.spread_mm:.2f} mm RMS "
            f"to {best.remaining_mm:.2f}"
        )
        more = [f"{name} ({mm:.2f})" for name, mm in [*measurement.in_turn_mm.items()][1:]]
        if more:
            lines.append(f"beside it, in this order: {', '.join(more)}")
    for name, errors in (result.left_out or {}).items():
        if errors is None:
            lines.append(f"{name} left out: not started, because the time was used")
            continue
        before, after = errors["before"]["surface_rms"]["mean"], errors["after"]["surface_rms"]["mean"]
        floor = errors["after"]["surface_floor"]["mean"]
        alone = errors.get("without_effects")
        between = f"{alone['surface_rms']['mean']:.2f} with factors alone, " if alone else ""
        lines.append(f"{name} left out: surface RMS {before:.2f} -> {between}{after:.2f} mm, noise floor {floor:.2f}")
    return "\n".join(lines)
