"""A page of blocks: one file for any browser, without a network. A block is a frozen dataclass that brings its HTML
with it, so that a new one is one declaration: fields, and a text of Jinja in which `block` is the block."""

import base64
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, ClassVar

from jinja2 import Environment, PackageLoader
from markupsafe import Markup, escape
from numpy.typing import NDArray

from fabdesign.drawings.layout_drawing import layout_svg
from fabdesign.nouns.design import Design
from fabdesign.units import in_kpa, in_mm
from fabdesign.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Block:
    """A part of a page."""

    html: ClassVar[str]  # Jinja; `block` is the block, `draw` gives the HTML of one inside


@dataclass(frozen=True)
class Title(Block):
    """A heading; level 1 is the page's own."""

    text: str
    level: int = 2
    html = "<h{{ block.level }}>{{ block.text }}</h{{ block.level }}>"


@dataclass(frozen=True)
class Text(Block):
    """A paragraph. style: "verdict", "note" (what must not be missed), "quiet" (what explains), or none."""

    text: str  # Markup keeps its elements
    style: str = ""
    html = """<p{% if block.style %} class="{{ block.style }}"{% endif %}>{{ block.text }}</p>"""


@dataclass(frozen=True)
class TableBlock(Block):
    """Rows of cells, numbers that are no whole ones with two decimals. The last cell of a short row takes what is left.

    left_aligned: columns besides the first whose words begin at the left. bold: rows. Both by their number, from 0.
    """

    head: Sequence[str]
    rows: Iterable[Sequence[object]]
    left_aligned: Sequence[int] = ()
    bold: Sequence[int] = ()
    html = """<table>{% macro place(k) %}{% if k in block.left_aligned %} class="left"{% endif %}{% endmacro %}
{%- if block.head %}<tr>{% for cell in block.head %}<th{{ place(loop.index0) }}>{{ cell | cell }}</th>{% endfor %}</tr>
{% endif %}{% for row in block.rows %}{% set more = block.head | length - row | length %}
<tr{% if loop.index0 in block.bold %} class="bold"{% endif %}>{% for cell in row %}{% if loop.last and more > 0 %}
<td class="left" colspan="{{ more + 1 }}">{% else %}<td{{ place(loop.index0) }}>{% endif %}{{ cell | cell }}</td>
{%- endfor %}</tr>{% endfor %}</table>"""


@dataclass(frozen=True)
class Columns(Block):
    """Blocks side by side, a list of them a column. style: "two" of equal width, "wide" and "cell" with a wider first
    one, "faces" as many as there is room for."""

    parts: Sequence[Iterable[Block]]
    style: str = "two"
    html = """<div class="{{ block.style }}">{% for part in block.parts %}<div>{% for one in part %}{{ draw(one) }}
{% endfor %}</div>{% endfor %}</div>"""


@dataclass(frozen=True)
class Picture(Block):
    """A figure of Matplotlib as SVG, or a PNG. alt: what a PNG shows."""

    content: "Figure | bytes"
    alt: str = ""
    html = """{% if block.alt %}<img src="{{ block.content | png }}" alt="{{ block.alt }}">{% else %}{{ block.content |
svg }}{% endif %}"""


@dataclass(frozen=True, eq=False)
class LayoutBlock(Block):
    """A layout drawn flat. pressures (channels,) Pa; `highest` Pa has the strongest colour."""

    design: Design
    pressures: NDArray[Any]
    highest: float
    html = "{{ block.design | layout(block.pressures, block.highest) }}"


@dataclass(frozen=True)
class MotionBlock(Block):
    """A page of `studies.view.page` within this one: shapes that turn and play."""

    page: str
    html = """<iframe title="motion" srcdoc="{{ block.page }}"></iframe>"""


@dataclass(frozen=True, eq=False)
class Chart(Block):
    """A figure of Plotly (`charts.py`). name: of the element that it is drawn in."""

    name: str
    figure: Any
    html = """<div id="{{ block.name }}"></div>"""


def html_of(title: str, blocks: Iterable[Block]) -> str:
    """Return the HTML of blocks, one below the other; without a chart among them the page holds no Plotly."""
    figures: dict[str, str] = {}

    def draw(block: Block) -> Markup:
        if isinstance(block, Chart):
            figures[block.name] = block.figure.to_json()  # in which no < ends the script that holds it
        return Markup(_environment().from_string(block.html).render(block=block, draw=draw))

    body = Markup("\n").join([draw(block) for block in blocks])
    plotly = ""
    if figures:
        from plotly.offline import get_plotlyjs

        plotly = get_plotlyjs()
    data = ",".join(f'"{name}":{figure}' for name, figure in figures.items())
    return drawn("report/page.html.j2", title=title, body=body, figures=Markup(f"{{{data}}}"), plotly=Markup(plotly))


def drawn(template: str, **content: object) -> str:
    """Return a page by its template, a file below `studies`."""
    return _environment().get_template(template).render(content)


def texts(style: str, sentences: Iterable[str | None]) -> list[Text]:
    """Return a paragraph of a style for each sentence that there is."""
    return [Text(sentence, style) for sentence in sentences if sentence]


def columns(table: Mapping[str, Iterable[object]]) -> TableBlock:
    """Return a table of columns of one length, by their heads."""
    return TableBlock([*table], [*zip(*table.values(), strict=True)])


def mm(metres: float, digits: int = 2) -> str:
    """Return a length in mm."""
    return f"{in_mm(metres):.{digits}f}"


def kpa(pascals: float) -> str:
    """Return a pressure in whole kPa."""
    return f"{in_kpa(pascals):.0f}"


def sentence(text: str) -> str:
    """Return it with a capital at its beginning and a full stop at its end."""
    name = "_" in text.partition(" ")[0]  # of an effect, which stays as it is written elsewhere
    return (text if name else text[:1].upper() + text[1:]) + ("" if text.endswith((".", "!", "?", ":")) else ".")


def interval(ends: Sequence[float], number: str = ".2f") -> str:
    """Return "0.80 to 1.60". number: how both ends are formatted."""
    return f"{ends[0]:{number}} to {ends[1]:{number}}"


def gain_in_words(value: float, interval90: Sequence[float], unit: str, number: str = ".2f") -> str:
    """Return "1.20 mm (90 % 0.80 to 1.60)", or "none" where there is no gain. number: how values are formatted."""
    if value <= 0:
        return "none"
    ends = interval([max(end, 0.0) for end in interval90], number)
    return f"{f'{value:{number}} {unit}'.rstrip()} (90 % {ends})"


def package_versions(packages: Sequence[str]) -> str:
    """Return what made a result: "fabdesign 1.0, numpy 2.1"."""
    return ", ".join([f"fabdesign {__version__}", *(f"{name} {version(name)}" for name in packages)])


def svg_of(figure: "Figure") -> Markup:
    """Return an SVG element; the same figure gives the same text."""
    text = io.StringIO()
    figure.savefig(text, format="svg", bbox_inches="tight", metadata={"Date": None, "Creator": None})
    return Markup(re.sub(r"^.*?(?=<svg)", "", text.getvalue(), flags=re.DOTALL))


def png_address(png: bytes) -> str:
    """Return a PNG as an address that an image element takes."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def _cell(value: object) -> Markup:
    """Return what stands in a cell; a line break stays one."""
    text = "" if value is None else f"{value:.2f}" if isinstance(value, float) else value
    return escape(text).replace("\n", Markup("<br>"))


@cache
def _environment() -> Environment:
    environment = Environment(autoescape=True, loader=PackageLoader("studies", ""))
    shown = {"cell": _cell, "svg": svg_of, "png": png_address, "layout": lambda *args: Markup(layout_svg(*args))}
    environment.filters.update(shown)
    return environment
