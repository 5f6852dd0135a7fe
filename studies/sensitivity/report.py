"""The folder of a sweep: numbers, samples and a page."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fabdesign.csv_table import write_rows
from fabdesign.json_file import write_json
from fabdesign.output import write_text
from fabdesign.sensitivity_file import SensitivityStudy
from fabdesign.units import in_kpa
from studies.report import html_of, package_versions, svg_of
from studies.sensitivity.result import SensitivityResult

FIRST, TOTAL, SIGMA = "#2166ac", "#92c5de", "#b2182b"


def bars_figure(result: SensitivityResult, column: int) -> Figure:
    """Return of one output Sobol indices and Morris' mu* with their 90 % intervals, the largest on top."""
    panels = [draw for draw, own in ((_sobol, result.indices[column]), (_morris, result.screenings[column])) if own]
    names = max(len(result.inputs.names), len(result.inputs.groups))
    figure = Figure(figsize=(5.4 * len(panels), 1.4 + 0.32 * names), layout="constrained")
    for draw, axes in zip(panels, np.atleast_1d(figure.subplots(1, len(panels))), strict=True):
        draw(axes, result, column)
        axes.legend(fontsize="small", frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0, 1), borderpad=0)
        axes.grid(axis="x", color="#e3e7ec")
        axes.set_axisbelow(True)
    return figure


def _sobol(axes: Axes, result: SensitivityResult, column: int) -> None:
    indices = result.indices[column]
    assert indices is not None
    names, order = [*result.inputs.groups], np.argsort(indices.total)
    place = np.arange(len(order))
    for shift, values, interval, colour, label in (
        (0.2, indices.total, indices.total90, TOTAL, "total"),
        (-0.2, indices.first, indices.first90, FIRST, "first order"),
    ):
        axes.barh(place + shift, values[order], 0.4, xerr=_reach(values, interval)[:, order], color=colour, label=label)
    axes.set_yticks(place, [names[i] for i in order])
    axes.axvline(0, color="#1c2430", linewidth=0.8)
    axes.set(xlabel="Sobol index, share of the variance, with 90 % intervals")


def _morris(axes: Axes, result: SensitivityResult, column: int) -> None:
    screening = result.screenings[column]
    assert screening is not None
    order = np.argsort(screening.mu_star)
    place = np.arange(len(order))
    reach = _reach(screening.mu_star, screening.mu_star90)[:, order]
    axes.barh(place, screening.mu_star[order], 0.6, xerr=reach, color=TOTAL, label="mu*")
    axes.plot(screening.sigma[order], place, "D", color=SIGMA, markersize=4, label="sigma")
    axes.set_yticks(place, [result.inputs.names[i] for i in order])
    axes.set(xlabel=f"Morris effect over the whole range, {result.columns[column].unit}, with 90 % intervals")


def _reach(values: np.ndarray, interval: np.ndarray) -> np.ndarray:
    """(2, n) how far the intervals reach to either side of the values."""
    return np.clip(np.stack([values - interval[:, 0], interval[:, 1] - values]), 0, None)


PACKAGES = ("taichi", "numpy", "scipy")


def write_report(result: SensitivityResult, out: Path) -> None:
    """Write `result.json`, `samples.csv` and `report.html` into the folder `out`."""
    write_json(out / "result.json", result.as_json())
    header = [*result.inputs.names, *(f"{c.name} [{c.unit}]" for c in result.columns)]
    write_rows(out / "samples.csv", ["method", "row", "sample", *header], _rows(result))
    write_text(out / "report.html", render(result))


def _rows(result: SensitivityResult) -> Iterator[list[Any]]:
    for method, samples in result.computed.items():
        for row, outputs in enumerate(samples.outputs):
            for k, numbers in enumerate(outputs):
                values = [f"{x:.9g}" for x in samples.values[row, k]]
                yield [method, row, k, *values, *("" if x != x else f"{x:.9g}" for x in numbers)]


def render(result: SensitivityResult) -> str:
    """HTML, self-contained."""
    varies = [k for k in range(len(result.columns)) if result.screenings[k] or result.indices[k]]
    return html_of(
        "sensitivity/report.html.j2",
        result=result,
        study=result.study,
        columns=result.columns,
        varies=varies,
        bars={k: Markup(svg_of(bars_figure(result, k))) for k in varies},
        json=result.as_json(),
        held=_held(result.study),
        versions=package_versions(PACKAGES),
    )


def _held(study: SensitivityStudy) -> str:
    """The pressures that do not vary, kPa."""
    varied = {v.name for v in study.varied}
    pressures = enumerate(in_kpa(study.pressures))
    return ", ".join(f"pressure.{k} {kpa:g}" for k, kpa in pressures if f"pressure.{k}" not in varied)


def as_text(result: SensitivityResult) -> str:
    """For people: of every output the parameters that matter most."""
    lines = []
    for column, output in result.as_json()["outputs"].items():
        lines.append(
            f"{column}: {output['mean']:.4g} {output['unit']} (90 % {output['low90']:.4g} to {output['high90']:.4g})"
        )
        if "sobol" in output:
            ranked = sorted(output["sobol"].items(), key=lambda item: -item[1]["total"])
            lines += [
                f"  {name:<28} first {x['first']:6.3f} ({_pair(x['first_interval90'])})   "
                f"total {x['total']:6.3f} ({_pair(x['total_interval90'])})"
                for name, x in ranked
            ]
        if "morris" in output:
            ranked = sorted(output["morris"].items(), key=lambda item: -item[1]["mu_star"])
            lines += [
                f"  {name:<28} mu* {x['mu_star']:8.4g} ({_pair(x['interval90'])})   sigma {x['sigma']:8.4g}"
                for name, x in ranked
            ]
    return "\n".join([*lines, *result.sentences])


def _pair(interval: list[float]) -> str:
    return f"{interval[0]:.3g} to {interval[1]:.3g}"
