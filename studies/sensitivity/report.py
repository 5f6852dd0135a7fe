"""The folder of a sweep: numbers, samples and a page."""

import json
from collections.abc import Iterator
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment
from markupsafe import Markup

from fabdesign import __version__
from fabdesign.csv_table import write_rows
from fabdesign.output import write_text
from fabdesign.sensitivity_file import SensitivityStudy
from studies.sensitivity.picture import bars_svg
from studies.sensitivity.result import SensitivityResult

PACKAGES = ("taichi", "numpy", "scipy")


def write_report(result: SensitivityResult, out: Path) -> None:
    """Write `result.json`, `samples.csv` and `report.html` into the folder `out`."""
    write_text(out / "result.json", json.dumps(result.as_json(), indent=2) + "\n")
    header = [*result.inputs.names, *(f"{c.name} [{c.unit}]" for c in result.columns)]
    write_rows(out / "samples.csv", ["method", "row", "sample", *header], _rows(result))
    write_text(out / "report.html", render(result))


def _rows(result: SensitivityResult) -> Iterator[list[Any]]:
    for method, found in result.computed.items():
        for row, outputs in enumerate(found.outputs):
            for k, numbers in enumerate(outputs):
                values = [f"{x:.9g}" for x in found.values[row, k]]
                yield [method, row, k, *values, *("" if x != x else f"{x:.9g}" for x in numbers)]


def render(result: SensitivityResult) -> str:
    """HTML, self-contained."""
    template = Environment(autoescape=True).from_string(
        files("studies.sensitivity").joinpath("report.html.j2").read_text(encoding="utf-8")
    )
    varies = [k for k in range(len(result.columns)) if result.screenings[k] or result.indices[k]]
    return template.render(
        result=result,
        study=result.study,
        columns=result.columns,
        varies=varies,
        bars={k: Markup(bars_svg(result, k)) for k in varies},
        json=result.as_json(),
        held=_held(result.study),
        versions=", ".join([f"fabdesign {__version__}", *(f"{name} {version(name)}" for name in PACKAGES)]),
    )


def _held(study: SensitivityStudy) -> str:
    """The pressures that do not vary, kPa."""
    varied = {v.name for v in study.varied}
    pressures = enumerate(study.pressures / 1e3)
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
        elif "morris" in output:
            ranked = sorted(output["morris"].items(), key=lambda item: -item[1]["mu_star"])
            lines += [
                f"  {name:<28} mu* {x['mu_star']:8.4g} ({_pair(x['interval90'])})   sigma {x['sigma']:8.4g}"
                for name, x in ranked
            ]
    return "\n".join([*lines, *result.sentences])


def _pair(interval: list[float]) -> str:
    return f"{interval[0]:.3g} to {interval[1]:.3g}"
