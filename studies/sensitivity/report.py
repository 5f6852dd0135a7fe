"""The folder of a sweep: numbers, samples and a page."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fabdesign.csv_table import write_rows
from fabdesign.json_file import write_json
from fabdesign.output import write_text
from fabdesign.sensitivity_file import SensitivityStudy
from fabdesign.units import in_kpa
from studies.report import page
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
    """Return HTML, self-contained."""
    return page.html_of(result.study.name, _blocks(result))


def _blocks(result: SensitivityResult) -> Iterator[page.Block]:
    study, outputs = result.study, result.as_json()["outputs"]
    yield page.Heading(study.name, 1)
    shape = "motion" if study.at else "shape at rest"
    yield page.Text(
        f"What the {shape} of design {study.design.name} depends on: {result.samples} samples, "
        f"{study.points_per_side} grid points a side, seed {study.seed}."
    )
    for line in result.sentences:
        yield page.Text(line, "note" if line in result.warnings else "quiet")
    rows = [
        (f"{name}, {x['unit']}", f"{x['mean']:.4g}", f"{x['std']:.3g}", f"{x['low90']:.4g} to {x['high90']:.4g}")
        for name, x in outputs.items()
    ]
    yield page.Table(("output", "mean", "standard deviation", "90 % of samples"), rows)
    for k, (name, output) in enumerate(outputs.items()):
        if "sobol" in output or "morris" in output:
            yield page.Heading(name)
            yield page.Picture(bars_figure(result, k))
            yield from _tables(output)
    yield page.Heading("How to read it")
    yield page.Text(" ".join(_how(result)))
    varied = [(v.name, v.what, v.unit or "factor", f"{v.low:g}", f"{v.high:g}") for v in study.varied]
    yield page.Table(("varied", "what", "unit", "from", "to"), varied, left=(1,))
    if held := _held(study):
        yield page.Text(f"Held, kPa: {held}.")
    times = f"{result.wall_s:.0f} s by the clock, {result.cpu_s:.0f} s of the processor"
    yield page.Text(f"{times}. {page.package_versions(PACKAGES)}.", "quiet")


def _tables(output: dict[str, Any]) -> Iterator[page.Block]:
    """Yield the measures of an output, the parameters that matter most first."""
    unit = output["unit"]
    if sobol := ranked(output, "sobol", "total"):
        rows = [
            (
                *(name, f"{x['first']:.3f}", page.interval(x["first_interval90"], ".3f")),
                *(f"{x['total']:.3f}", page.interval(x["total_interval90"], ".3f")),
            )
            for name, x in sobol
        ]
        yield page.Table(("Sobol", "first order", "90 %", "total", "90 %"), rows)
    if morris := ranked(output, "morris", "mu_star"):
        rows = [
            (name, f"{x['mu_star']:.4g}", page.interval(x["interval90"], ".4g"), f"{x['mu']:.4g}", f"{x['sigma']:.4g}")
            for name, x in morris
        ]
        yield page.Table(("Morris", f"mu*, {unit}", "90 %", f"mu, {unit}", f"sigma, {unit}"), rows)


def ranked(output: dict[str, Any], method: str, by: str) -> list[tuple[str, dict[str, Any]]]:
    """Return a method's measures of an output by parameter, the largest first; none where it did not take part."""
    return sorted(output.get(method, {}).items(), key=lambda item: -item[1][by])


def _how(result: SensitivityResult) -> Iterator[str]:
    sobol, joint = "sobol" in result.computed, result.study.joint
    if sobol:
        yield (
            "First order: the share of the output's variance that the parameter causes alone. Total: the share with "
            "all its interactions. The difference between the two sums shows how much is interaction."
        )
    if "morris" in result.computed:
        yield (
            "mu*: mean absolute change of the output over the parameter's whole range. mu: the same with its sign. "
            "sigma: how much that change depends on the place in the ranges: 0 where the output is linear and the "
            "parameters do not interact."
        )
    yield "All intervals are bootstrap intervals, 90 %."
    if "tip" in result.study.outputs:
        yield "tip: the distance of the edge opposite the hung one from its place without pressure."
    if joint:
        yield "Parameters of the covariance are correlated."
    if joint and sobol:
        yield (
            "Each bar is the share of one parameter given those before it. The bar of all of them together does not "
            "depend on their order."
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
        lines += [
            f"  {name:<28} first {x['first']:6.3f} ({page.interval(x['first_interval90'], '.3g')})   "
            f"total {x['total']:6.3f} ({page.interval(x['total_interval90'], '.3g')})"
            for name, x in ranked(output, "sobol", "total")
        ]
        lines += [
            f"  {name:<28} mu* {x['mu_star']:8.4g} ({page.interval(x['interval90'], '.3g')})   sigma {x['sigma']:8.4g}"
            for name, x in ranked(output, "morris", "mu_star")
        ]
    return "\n".join([*lines, *result.sentences])
