"""A page from a template of `studies`, with values in SI that the filters `mm` and `kpa` show, and pictures as text
that stands in a page."""

import base64
import io
import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, TypedDict

from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from fabdesign import __version__
from fabdesign.units import in_kpa, in_mm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Trace = dict[str, Any]  # as Plotly takes it: type, mode, x, y and so on


class PlotlyFigure(TypedDict):
    """Traces, and what they are drawn in."""

    data: Sequence[Trace]
    layout: dict[str, Any]


def html_of(template: str, *, figures: Mapping[str, PlotlyFigure] | None = None, **values: Any) -> str:
    """HTML of `template`, a path in `studies` as "layouts/report.html.j2", with `values` by name.

    figures: Plotly's figures by the id of the element that they are drawn in; without one the page holds no Plotly.
    """
    plotly = ""
    if figures:
        from plotly.offline import get_plotlyjs

        plotly = get_plotlyjs()
    return (
        _environment()
        .get_template(template)
        .render(**values, figures=Markup(_in_script(figures or {})), plotly=Markup(plotly), version=__version__)
    )


def package_versions(packages: Sequence[str]) -> str:
    """What made a result: "fabdesign 1.0, numpy 2.1"."""
    return ", ".join([f"fabdesign {__version__}", *(f"{name} {version(name)}" for name in packages)])


def svg_of(figure: "Figure") -> str:
    """An SVG element; the same figure gives the same text."""
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return re.sub(r"^.*?(?=<svg)", "", text.getvalue(), flags=re.DOTALL)


def png_address(png: bytes) -> str:
    """A PNG as an address that an image element takes."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


@cache
def _environment() -> Environment:
    environment = Environment(autoescape=True, loader=PackageLoader("studies", ""))
    environment.filters["sentence"] = _sentence
    environment.filters["mm"] = lambda metres, digits=2: f"{in_mm(metres):.{digits}f}"
    environment.filters["kpa"] = lambda pascals, digits=0: f"{in_kpa(pascals):.{digits}f}"
    return environment


def _sentence(text: str) -> str:
    """Return it with a capital at its beginning and a full stop at its end."""
    name = "_" in text.partition(" ")[0]  # of an effect, which stays as it is written elsewhere
    return (text if name else text[:1].upper() + text[1:]) + ("" if text.endswith((".", "!", "?", ":")) else ".")


def _in_script(content: Any) -> str:
    """JSON that may stand in a script element."""
    return json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")
