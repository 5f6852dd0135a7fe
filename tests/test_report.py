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
from studies.report import Gain, chart, gain_in_words, gains_chart, html_of, png_address, scene_layout, svg_of
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


def test_axes_have_titles_as_this_plotly_takes_them() -> None:
    """A title that is a bare text is dropped without a word."""
    layout = chart([], x="time, s", y="force, N", yaxis={"type": "log"})["layout"]
    assert layout["xaxis"]["title"]["text"] == "time, s" and layout["yaxis"]["type"] == "log"
    assert layout["xaxis"]["automargin"] and layout["yaxis"]["title"]["text"] == "force, N"
    sources = [*(ROOT / "studies").rglob("*.py")]
    assert not [file.name for file in sources if re.search(r'"title": f?"', file.read_text(encoding="utf-8"))]


def test_every_candidate_has_its_name_and_a_loss_is_no_gain() -> None:
    gains = [Gain(f"effect {k}", 1.0 - k, (0.5 - k, 1.5 - k), k == 0) for k in range(20)]
    figure = gains_chart(gains, "mm", "gain", 0.5)
    (marks,) = figure["data"]
    assert marks["y"][-1] == "<b>effect 0</b>" and len(marks["y"]) == 20
    assert figure["layout"]["yaxis"]["dtick"] == 1 and figure["layout"]["height"] > 20 * 20
    assert min(marks["x"]) == 0 and min(marks["error_x"]["arrayminus"]) >= 0
    assert gain_in_words(-0.82, (-1.46, 0.0), "mm") == "none"
    assert gain_in_words(0.5, (-0.1, 1.0), "mm") == "0.50 mm (90 % 0.00 to 1.00)"


@pytest.mark.parametrize("size", [(0.2, 0.2), (0.24, 0.15), (0.1, 0.4)])
def test_a_scene_of_any_proportions_is_as_large_and_true_to_scale(size: tuple[float, float]) -> None:
    trace = {"x": [0.0, size[0]], "y": [-size[1], 0.0], "z": [0.0, 0.03]}
    scene = scene_layout([trace])["scene"]
    ratio = np.array([scene["aspectratio"][axis] for axis in "xyz"])
    extent = np.array([np.diff(scene[f"{axis}axis"]["range"])[0] for axis in "xyz"])
    assert np.linalg.norm(ratio) == pytest.approx(1.5)
    np.testing.assert_allclose(ratio / extent, ratio[0] / extent[0])
    assert (extent > [size[0], size[1], 0.03]).all()


def test_a_sentence_begins_with_a_capital_and_ends() -> None:
    assert _environment().from_string("{{ 'a line' | sentence }} {{ 'b.' | sentence }}").render() == "A line. B."
