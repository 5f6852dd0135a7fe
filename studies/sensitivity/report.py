"""The folder of a sweep: numbers, samples and a page."""

from collections.abc import Iterator
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fabdesign.formats.csv_table import write_rows
from fabdesign.study_files.sensitivity_file import SensitivityStudy
from fabdesign.units import in_kpa
from studies.report import page
from studies.sensitivity.result import SensitivityResult
from studies.study import write_result

FIRST, TOTAL, SIGMA = "#2166ac", "#92c5de", "#b2182b"
PACKAGES = ("taichi", "numpy", "scipy")
_MEANS = {  # in the order in which they are said
    "sobol": """First order: the share of the output's variance that the parameter causes alone. Total: the share with
        all its interactions. The difference between the two sums shows how much is interaction. """,
    "morris": """mu*: mean absolute change of the output over the parameter's whole range. mu: the same with its sign.
        sigma: how much that change depends on the place in the ranges: 0 where the output is linear and the parameters
        do not interact. """,
    "all": "All intervals are bootstrap intervals, 90 %. ",
    "tip": "tip: the distance of the edge opposite the hung one from its place without pressure. ",
    "joint": "Parameters of the covariance are correlated. ",
    "given": """Each bar is the share of one parameter given those before it. The bar of all of them together does not
        depend on their order.""",
}


def bars_figure(result: SensitivityResult, column: int) -> Figure:
    """Return of one output Sobol indices and Morris' mu* with their 90 % intervals, the largest on top."""
    names, groups = result.inputs.names, result.inputs.groups
    panels: list[Any] = []  # names, what is shown, by what they are sorted, bars, diamonds
    measured = {method: each[column] for method, each in result.measures.items()}
    if sobol := measured.get("sobol"):
        bars = [(0.2, sobol["total"], sobol["total_interval90"], TOTAL, "total")]
        bars.append((-0.2, sobol["first"], sobol["first_interval90"], FIRST, "first order"))
        panels.append(([*groups], "Sobol index, share of the variance", sobol["total"], bars, None))
    if morris := measured.get("morris"):
        bars = [(0.0, morris["mu_star"], morris["interval90"], TOTAL, "mu*")]
        what = f"Morris effect over the whole range, {result.watched[column].unit}"
        panels.append((names, what, morris["mu_star"], bars, morris["sigma"]))
    wide = 3.6 + 0.08 * max(map(len, [*names, *groups]))  # inches: the longest name beside bars with room for the title
    size = wide * len(panels), 1.5 + 0.32 * max(len(names), len(groups))
    figure = Figure(figsize=size, layout="constrained")
    for axes, (title, what, by, bars, sigma) in zip(
        figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
    ):
        order, place = np.argsort(by), np.arange(len(by))
        for shift, values, ends, colour, label in bars:
            reach = np.clip([values - ends[:, 0], ends[:, 1] - values], 0, None)[:, order]
            style = {"height": 0.4 if shift else 0.6, "color": colour, "label": label}
            axes.barh(place + shift, values[order], xerr=reach, **style)
        if sigma is not None:
            axes.plot(sigma[order], place, "D", color=SIGMA, markersize=4, label="sigma")
        axes.axvline(0, color="#1c2430", linewidth=0.8)
        axes.set_yticks(place, [title[i] for i in order])
        axes.set(xlabel=fill(f"{what}, with 90 % intervals", 40), axisbelow=True)
        axes.legend(fontsize="small", frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0, 1), borderpad=0)
        axes.grid(axis="x", color="#e3e7ec")
    return figure


def write_report(result: SensitivityResult, out: Path) -> None:
    """Write `result.json`, `samples.csv` and `report.html` into the folder `out`."""
    write_result(out, result, result.study.name, _blocks(result))
    header = [*result.inputs.names, *(f"{c.name} [{c.unit}]" for c in result.watched)]
    write_rows(out / "samples.csv", ["method", "row", "sample", *header], _rows(result))


def _rows(result: SensitivityResult) -> Iterator[list[Any]]:
    for method, samples in result.computed.items():
        for row, outputs in enumerate(samples.outputs):
            for k, numbers in enumerate(outputs):
                values = [f"{x:.9g}" for x in samples.values[row, k]]
                yield [method, row, k, *values, *("" if x != x else f"{x:.9g}" for x in numbers)]


def _blocks(result: SensitivityResult) -> Iterator[page.Block]:
    study, outputs = result.study, result.outputs
    yield page.Title(study.name, 1)
    yield page.Text(f"""What the {"motion" if study.at else "shape at rest"} of design {study.design.name} depends on:
        {result.samples} samples, {study.points_per_side} grid points a side, seed {study.seed}.""")
    for line in result.sentences:
        yield page.Text(line, "note" if line in result.warnings else "quiet")
    rows = [
        (f"{name}, {x['unit']}", f"{x['mean']:.4g}", f"{x['std']:.3g}", f"{x['low90']:.4g} to {x['high90']:.4g}")
        for name, x in outputs.items()
    ]
    yield page.TableBlock(("output", "mean", "standard deviation", "90 % of samples"), rows)
    for k, (name, output) in enumerate(outputs.items()):
        if "sobol" in output or "morris" in output:
            yield page.Title(name)
            yield page.Picture(bars_figure(result, k))
            yield from _tables(output)
    yield page.Title("How to read it")
    apply = {"all", *result.computed, *({"tip"} & {*study.outputs})}
    if study.joint:
        apply |= {"joint", "given"} if "sobol" in apply else {"joint"}
    yield page.Text("".join(text for name, text in _MEANS.items() if name in apply))
    varied = [(v.name, v.what, v.unit or "factor", f"{v.low:g}", f"{v.high:g}") for v in study.varied]
    yield page.TableBlock(("varied", "what", "unit", "from", "to"), varied, left_aligned=(1,))
    yield from page.texts("", [f"Held, kPa: {held}." if (held := _held(study)) else None])
    times = f"{result.wall_s:.0f} s by the clock, {result.cpu_s:.0f} s of the processor"
    yield page.Text(f"{times}. {page.package_versions(PACKAGES)}.", "quiet")


def _tables(output: dict[str, Any]) -> Iterator[page.Block]:
    """Yield the measures of an output, the parameters that matter most first."""
    unit, ends = output["unit"], "90 %"
    sobol = {"first": "first order", "first_interval90": ends, "total": "total", "total_interval90": ends}
    morris = {"mu_star": f"mu*, {unit}", "interval90": ends, "mu": f"mu, {unit}", "sigma": f"sigma, {unit}"}
    for method, by, number, heads in (("sobol", "total", ".3f", sobol), ("morris", "mu_star", ".4g", morris)):
        if measures := ranked(output, method, by):
            rows = [(name, *(_figure(x[key], number) for key in heads)) for name, x in measures]
            yield page.TableBlock((method.capitalize(), *heads.values()), rows)


def _figure(value: Any, number: str) -> str:
    return page.interval(value, number) if isinstance(value, list) else f"{value:{number}}"


def ranked(output: dict[str, Any], method: str, by: str) -> list[tuple[str, dict[str, Any]]]:
    """Return a method's measures of an output by parameter, the largest first; none where it did not take part."""
    return sorted(output.get(method, {}).items(), key=lambda item: -item[1][by])


def _held(study: SensitivityStudy) -> str:
    """Return the pressures that do not vary, kPa."""
    varied = {v.name for v in study.varied}
    pressures = enumerate(in_kpa(study.pressures))
    return ", ".join(f"pressure.{k} {kpa:g}" for k, kpa in pressures if f"pressure.{k}" not in varied)


def as_text(result: SensitivityResult) -> str:
    """Return in words of every output the parameters that matter most."""
    lines = []
    for column, output in result.outputs.items():
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
