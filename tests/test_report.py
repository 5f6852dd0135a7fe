"""What the reports and results of all studies share: the base page, how values are shown, JSON without NaN."""

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from jinja2 import Environment, PackageLoader
from matplotlib.figure import Figure

from fabdesign.json_file import json_text, write_json
from studies.report import html_of, png_address, svg_of
from studies.report.page import _environment
from tests.conftest import ROOT

BENCH = {"name": "a <b>", "verdict": "effect", "words": "x", "source": "y", "records": ["record-0"]}


def test_a_page_holds_its_figures_and_plotly_only_with_one() -> None:
    figures = {"bars": {"data": [{"name": "</script>"}], "layout": {"title": "t"}}}
    page = html_of("tracing/bench_report.html.j2", figures=figures, **BENCH)  # type: ignore[arg-type]
    assert json.loads(re.findall(r'id="figures">(.*?)</script>', page)[0]) == figures
    assert page.count("Plotly.newPlot(id") == 1 and "<title>a &lt;b&gt;</title>" in page
    assert "<script" not in html_of("tracing/bench_report.html.j2", **BENCH)


def test_filters_show_mm_and_kpa() -> None:
    template = _environment().from_string("{{ 0.01234 | mm }} {{ 0.01234 | mm(0) }} {{ 123456 | kpa }}")
    assert template.render() == "12.34 12 123"


def test_every_report_extends_the_one_base() -> None:
    environment = Environment(loader=PackageLoader("studies", ""))
    reports = [name for name in environment.list_templates(extensions=["j2"]) if name.endswith("report.html.j2")]
    assert len(reports) >= 7
    for name in reports:
        text = (ROOT / "studies" / name).read_text(encoding="utf-8")
        assert text.startswith('{% extends "report/base.html.j2" %}') and "1e3" not in text, name


def test_the_same_figure_gives_the_same_svg() -> None:
    figures = [Figure(), Figure()]
    for figure in figures:
        figure.subplots().plot([0, 1], [1, 0])
    one, other = (re.sub(r'(id|href|url\()[="#]*[\w#-]+', "", svg_of(figure)) for figure in figures)
    assert one.startswith("<svg") and one == other
    assert png_address(b"\x89PNG") == "data:image/png;base64,iVBORw=="


@dataclass(frozen=True)
class Inner:
    value: float
    points: np.ndarray


def test_json_of_results_knows_no_nan(tmp_path: Path) -> None:
    content = {"a": Inner(float("nan"), np.array([1.0, np.inf])), "b": (np.float32(0.5), Path("x")), "c": None}
    assert json.loads(json_text(content)) == {"a": {"value": None, "points": [1.0, None]}, "b": [0.5, "x"], "c": None}
    write_json(tmp_path / "r.json", content)
    assert json.loads((tmp_path / "r.json").read_text()) == json.loads(json_text(content))
    with pytest.raises(TypeError):
        json_text({"a": object()})
