"""What the reports of all studies share: one base page (`base.html.j2`: head, style, figures), how a page is made from
it, and pictures that stand in a page. A report is one file for any browser, without a network.

Belongs here: what two reports need. What one study shows stands in its room: `report.py`, and `report.html.j2`, which
begins with `{% extends "report/base.html.j2" %}`."""

from studies.report.charts import (
    BLUE,
    DARK,
    GREY,
    RED,
    Gain,
    bars_chart,
    chart,
    gain_in_words,
    gains_chart,
    line,
    scene_layout,
)
from studies.report.page import PlotlyFigure, Trace, html_of, package_versions, png_address, svg_of

__all__ = [
    "BLUE", "DARK", "GREY", "RED", "Gain", "PlotlyFigure", "Trace", "bars_chart", "chart", "gain_in_words",
    "gains_chart", "html_of", "line", "package_versions", "png_address", "scene_layout", "svg_of",
]  # fmt: skip
