"""The folder of a study of what is not measured yet: numbers and a page."""

from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from fabdesign.json_file import write_json
from fabdesign.output import write_text
from fabdesign.toml_file import file_stem
from fabdesign.units import in_mm
from studies.evaluate import ERROR_NAMES
from studies.report import html_of, png_address, svg_of
from studies.unseen.result import PoseResult, UnseenResult


def write_report(result: UnseenResult, out: Path, *, pictures: Path) -> None:
    """Write `result.json` and `report.html` into `out`; `pictures` holds the overlays."""
    write_json(out / "result.json", without_lines(result))
    left_out = result.get("left_out") or {}
    left = {name: own for name, own in left_out.items() if own}
    page = html_of(
        "unseen/report.html.j2",
        result=result,
        left=left,
        not_begun=[name for name, own in left_out.items() if not own],
        effects={name: _effect_rows(own["effects"]) for name, own in left.items()},
        notes=_notes(result),
        bands=[Markup(_band_svg(pose)) for pose in result.get("poses") or []],
        histograms={name: Markup(_histogram_svg(own)) for name, own in left.items()},
        overlays={name: png_address((pictures / f"left_out_{file_stem(name)}.png").read_bytes()) for name in left},
    )
    write_text(out / "report.html", page)


def _effect_rows(effects: list[dict[str, Any]]) -> list[tuple[str, str, str, str]]:
    """Name, value, interval, unit of every parameter."""
    return [
        (
            f"{effect['name']}.{name}".replace("_", " "),
            f"{p['value']:.4g}",
            "held" if p["interval90"] is None else "{:.4g} to {:.4g}".format(*p["interval90"]),
            "" if p["unit"] == "1" else p["unit"],
        )
        for effect in effects
        for name, p in effect["parameters"].items()
    ]


def _notes(result: UnseenResult) -> list[str]:
    """What must be said beside the shapes' intervals."""
    if not result.get("design"):
        return []
    notes, own, grid = [], result["model_points_per_side"], result["points_per_side"]
    notes.append(result["intervals"])
    if result["doubted"] and not result["calibrated"]:
        notes.append(
            f"the model's intervals of {', '.join(result['doubted'])} are not reliable: its fit left more than "
            "noise. The intervals here follow from them and are probably too narrow"
        )
    if own != grid:
        notes.append(f"the model's factors belong to a grid of {own} points a side; these shapes have {grid}")
    if result["unknown"]:
        unknown = ", ".join(result["unknown"])
        notes.append(
            f"the model has no data on {unknown}: the tolerance of the data sheet is used (15 %). A bench reduces it"
        )
    return notes


def without_lines(result: UnseenResult) -> UnseenResult:
    """The result without the middle lines, which are for the picture."""
    shown = result.copy()
    if poses := result.get("poses"):
        shown["poses"] = poses = [pose.copy() for pose in poses]
        for pose in poses:
            pose.pop("middle", None)
    return shown


def _band_svg(pose: PoseResult) -> str:
    """The cloth's middle line from the side: of every drawn model, and their mean."""
    lines = in_mm(np.array(pose["middle"]))
    figure = Figure(figsize=(4.2, 4.2), layout="constrained")
    axes = figure.subplots()
    for line in lines:
        axes.plot(line[:, 0], line[:, 1], color="#92c5de", linewidth=0.6)
    axes.plot([], [], color="#92c5de", label="models drawn")
    axes.plot(*lines.mean(axis=0).T, color="#1c2430", linewidth=1.4, label="their mean")
    axes.legend(fontsize="small", frameon=False, loc="lower left", bbox_to_anchor=(0, 1))
    axes.set(xlabel="z, mm (front)", ylabel="y, mm", aspect="equal")
    return svg_of(figure)


def _histogram_svg(sizes: dict[str, Any]) -> str:
    figure = Figure(figsize=(7, 2.8), layout="constrained")
    for axes, error in zip(figure.subplots(1, 2), ("chamfer", "surface_rms"), strict=True):
        shown = sizes["histogram"][error]
        for state, colour in (("before", "#9aa5b1"), ("after", "#2166ac")):
            axes.stairs(shown[state], shown["edges"], fill=True, alpha=0.6, color=colour, label=state)
        axes.set(xlabel=f"{ERROR_NAMES[error]}, mm", ylabel="trials")
        axes.yaxis.get_major_locator().set_params(integer=True)
        axes.legend(fontsize="small", frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0, 1))
    return svg_of(figure)


def as_text(result: UnseenResult) -> str:
    """For people."""
    lines = []
    for pose in result.get("poses") or []:
        low, middle, high = pose["tip_mm"]["z"]
        shown = ", ".join(f"{p:g}" for p in pose["pressures_kpa"])
        snaps = "; may buckle to either side" if pose["snaps"] else ""
        lines.append(
            f"{shown} kPa: lower edge at z = {middle:.1f} mm (90 % {low:.1f} to {high:.1f}), "
            f"shape within {pose['band_mm']:.2f} mm RMS{snaps}"
        )
        for name, output in pose["outputs"].items():
            low, middle, high = output["percentiles"]
            lines.append(f"  {name}: {middle:.1f} {output['unit']} (90 % {low:.1f} to {high:.1f})")
    if result.get("design"):
        lines.append(result["corrector"]["said"])
        lines += _notes(result)
    measurement = result.get("measurement")
    if measurement and measurement["candidates"]:
        name, best = next(iter(measurement["candidates"].items()))
        lines.append(
            f"the best measurement: {name}, on {best['design']}; it reduces {measurement['spread_mm']:.2f} mm RMS "
            f"to {best['left_mm']:.2f}"
        )
        more = [f"{name} ({mm:.2f})" for name, mm in [*measurement["in_turn_mm"].items()][1:]]
        if more:
            lines.append(f"beside it, in this order: {', '.join(more)}")
    for name, left in (result.get("left_out") or {}).items():
        if left is None:
            lines.append(f"{name} left out: not started, because the time was used")
            continue
        before, after = left["before"]["surface_rms"]["mean"], left["after"]["surface_rms"]["mean"]
        floor = left["after"]["surface_floor"]["mean"]
        alone = left.get("without_effects")
        between = f"{alone['surface_rms']['mean']:.2f} with factors alone, " if alone else ""
        lines.append(f"{name} left out: surface RMS {before:.2f} -> {between}{after:.2f} mm, noise floor {floor:.2f}")
    return "\n".join(lines)
