"""What the reports and results of all studies share: the base page, how values are shown, JSON without NaN."""

import json
import re
from dataclasses import dataclass, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, ClassVar, get_type_hints

import numpy as np
import pytest
from matplotlib.figure import Figure

from fabdesign.formats.json_file import json_text, plain, write_json
from fabdesign.formats.schema import MM, Key, Millimetre, members
from studies.report import page
from studies.report.charts import chart, cloud, curve, gains, scene
from studies.report.page import gain_in_words, html_of, kpa, mm, png_address, sentence, svg_of
from tests.conftest import ROOT


def test_a_page_holds_its_figures_and_plotly_only_with_one() -> None:
    text = html_of("a <b>", [chart("bars", [curve("</script>", [0], [1])], x="t"), page.Text("x <b>")])
    figures = json.loads(re.findall(r'id="figures">(.*?)</script>', text)[0])
    assert [trace["name"] for trace in figures["bars"]["data"]] == ["</script>"]
    assert figures["bars"]["layout"]["xaxis"]["title"]["text"] == "t"
    assert text.count("Plotly.newPlot(id") == 1 and "<title>a &lt;b&gt;</title>" in text
    assert "<p>x &lt;b&gt;</p>" in text and '<div id="bars"></div>' in text
    assert "<script" not in html_of("a <b>", [page.Text("x")])


def test_a_new_block_is_one_declaration_as_contributing_has_it() -> None:
    recipe = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## Show something new on a page")[1]
    names = dict(vars(page))
    exec(recipe.split("```python\n")[1].split("```")[0], names)
    text = html_of("q", [page.Columns([[names["Quote"]("it <holds>", "a & b")]])])
    assert "<blockquote>it &lt;holds&gt;<br>a &amp; b</blockquote>" in text


def test_values_are_shown_in_mm_and_kpa() -> None:
    assert (mm(0.01234), mm(0.01234, 0), kpa(123456)) == ("12.34", "12", "123")


def test_one_template_draws_every_report() -> None:
    names = {file.relative_to(ROOT / "studies").as_posix() for file in (ROOT / "studies").rglob("*.j2")}
    assert names == {"report/page.html.j2", "view/page.html.j2"}
    assert "1e3" not in (ROOT / "studies/report/page.html.j2").read_text(encoding="utf-8")


def test_a_table_says_what_it_is_given() -> None:
    rows = [("a <b>", 1.0, None), (page.Markup("<b>c</b>"), "no value")]
    text = html_of("t", [page.TableBlock(("name", "of\nwhat", "mm"), rows, left_aligned=(1,), bold=(1,))])
    assert '<th>name</th><th class="left">of<br>what</th><th>mm</th>' in text
    assert '<td>a &lt;b&gt;</td><td class="left">1.00</td><td></td>' in text.replace("\n", "")
    assert '<tr class="bold"><td><b>c</b></td><td class="left" colspan="2">no value</td>' in text.replace("\n", "")


@dataclass(frozen=True)
class Quote(page.Block):
    text: str
    who: str
    html = "<blockquote>{{ block.text }}<br>{{ block.who }}</blockquote>"


def test_a_new_block_is_one_declaration() -> None:
    text = html_of("t", [page.Columns([[Quote("a < b", "me")], [page.Title("h", 3)]])])
    assert "<blockquote>a &lt; b<br>me</blockquote>" in text and "<h3>h</h3>" in text


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
    off: Annotated[Millimetre, Key("off_mm")] = 0.002


@dataclass(frozen=True)
class Outer:
    """A result whose file has a table, the keys of an inner one, and not all of it."""

    inner: Annotated[Inner | None, Key(inside=True)]
    depths: Annotated[np.ndarray, Key("depth.each_mm"), MM]
    name: Annotated[str, Key(brief=True)] = ""
    solver: object = None
    json_keys: ClassVar = ("depth.most_mm", lambda of: float(of.depths.max())), "depths", "inner", "name"


@dataclass(frozen=True)
class Apart:
    """A result whose keys are computed, or of what it holds."""

    outer: Outer
    json_keys: ClassVar = (
        ("several", lambda of: [of.outer]), "outer.depths", ("off.most_mm", "outer.inner.off"), ("**", "outer.inner")
    )  # fmt: skip


def test_json_of_a_result_is_as_it_declares_it() -> None:
    depths = np.array([0.001, 0.002])
    table = {"depth": {"most_mm": 2.0, "each_mm": [1.0, 2.0]}}
    outer = Outer(Inner(1.0, np.zeros(1)), depths, solver=object())
    assert plain(outer) == table | {"value": 1.0, "points": [0.0], "off_mm": 2.0}
    assert plain(Apart(Outer(None, depths, "n"))) == {
        "several": [table | {"name": "n"}],
        "depths": [0.001, 0.002],
        "off": {"most_mm": None},
    }
    assert plain(Apart(outer))["off"] == {"most_mm": 2.0} and plain(Apart(outer))["off_mm"] == 2.0


def _type_of(form: Any, name: str) -> Any:
    """Return the type of an attribute, without None; None where nothing says it."""
    member = getattr(form, name, None)
    getter = getattr(member, "fget", None) or getattr(member, "func", None)
    assert member is not None or name in form.__dataclass_fields__, f"{form.__name__} has no {name}"
    try:
        hint = get_type_hints(getter).get("return") if getter else get_type_hints(form).get(name)
    except NameError:  # of a type that is loaded for checks alone
        return None
    kinds = members(hint)
    return kinds[0] if len(kinds) == 1 and is_dataclass(kinds[0]) else None


def test_keys_of_results_are_of_what_is_there() -> None:
    files = [file for package in ("fabdesign", "studies") for file in (ROOT / package).rglob("*.py")]
    count = 0
    for file in (file for file in files if "    json_keys: ClassVar" in file.read_text(encoding="utf-8")):
        module = import_module(".".join(file.relative_to(ROOT).with_suffix("").parts))
        forms = [each for each in vars(module).values() if isinstance(each, type) and not each.__subclasses__()]
        for form in (each for each in forms if "json_keys" in vars(each)):
            for source in (entry[1] if isinstance(entry, tuple) else entry for entry in form.json_keys):
                kind: Any = form
                for name in () if callable(source) else source.split("."):
                    kind = kind and _type_of(kind, name)
                    count += 1
    assert count > 100


def test_json_of_results_knows_no_nan(tmp_path: Path) -> None:
    content = {"a": Inner(float("nan"), np.array([1.0, np.inf])), "b": (np.float32(0.5), Path("x")), "c": None}
    assert json.loads(json_text(content)) == {
        "a": {"value": None, "points": [1.0, None], "off_mm": 2.0},
        "b": [0.5, "x"],
        "c": None,
    }
    write_json(tmp_path / "r.json", content)
    assert json.loads((tmp_path / "r.json").read_text()) == json.loads(json_text(content))
    with pytest.raises(TypeError):
        json_text({"a": object()})


def test_axes_have_titles_as_this_plotly_takes_them() -> None:
    """A title that is a bare text is dropped without a word."""
    layout = chart("curves", [], x="time, s", y="force, N", yaxis={"type": "log"}).figure["layout"]
    assert layout["xaxis"]["title"]["text"] == "time, s" and layout["yaxis"]["type"] == "log"
    assert layout["xaxis"]["automargin"] and layout["yaxis"]["title"]["text"] == "force, N"
    sources = [*(ROOT / "studies").rglob("*.py")]
    assert not [file.name for file in sources if re.search(r'"title": f?"', file.read_text(encoding="utf-8"))]


def test_every_candidate_has_its_name_and_a_loss_is_no_gain() -> None:
    rows = [(f"effect {k}", 1.0 - k, (0.5 - k, 1.5 - k), k == 0) for k in range(20)]
    figure = gains("candidates", rows, "mm", "gain", 0.5).figure
    (marks,) = figure["data"]
    assert marks["y"][-1] == "<b>effect 0</b>" and len(marks["y"]) == 20
    assert figure["layout"]["yaxis"]["dtick"] == 1 and figure["layout"]["height"] > 20 * 20
    assert min(marks["x"]) == 0 and min(marks["error_x"]["arrayminus"]) >= 0
    assert gain_in_words(-0.82, (-1.46, 0.0), "mm") == "none"
    assert gain_in_words(0.5, (-0.1, 1.0), "mm") == "0.50 mm (90 % 0.00 to 1.00)"


@pytest.mark.parametrize("size", [(0.2, 0.2), (0.24, 0.15), (0.1, 0.4)])
def test_a_scene_of_any_proportions_is_as_large_and_true_to_scale(size: tuple[float, float]) -> None:
    points = np.array([[0.0, -size[1], 0.0], [size[0], 0.0, 0.03]])
    drawn = scene("shape", [cloud("points", points, "red")]).figure["layout"]["scene"]
    ratio = np.array([drawn["aspectratio"][axis] for axis in "xyz"])
    extent = np.array([np.diff(drawn[f"{axis}axis"]["range"])[0] for axis in "xyz"])
    assert np.linalg.norm(ratio) == pytest.approx(1.5)
    np.testing.assert_allclose(ratio / extent, ratio[0] / extent[0])
    assert (extent > [size[0], size[1], 0.03]).all()


def test_a_sentence_begins_with_a_capital_and_ends() -> None:
    assert (sentence("a line"), sentence("b.")) == ("A line.", "B.")
