"""Bars of a sweep, as SVG for the page."""

import io
import re

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.sensitivity.result import SensitivityResult

FIRST, TOTAL, SIGMA = "#2166ac", "#92c5de", "#b2182b"


def bars_svg(result: SensitivityResult, column: int) -> str:
    """Of one output: Sobol indices and Morris' mu* with their 90 % intervals, the largest on top."""
    panels = [draw for draw, found in ((_sobol, result.indices[column]), (_morris, result.screenings[column])) if found]
    names = max(len(result.inputs.names), len(result.inputs.groups))
    figure = Figure(figsize=(5.4 * len(panels), 1.1 + 0.32 * names), layout="constrained")
    for draw, axes in zip(panels, np.atleast_1d(figure.subplots(1, len(panels))), strict=True):
        draw(axes, result, column)
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return re.sub(r"^.*?(?=<svg)", "", text.getvalue(), flags=re.DOTALL)


def _sobol(axes: Axes, result: SensitivityResult, column: int) -> None:
    found = result.indices[column]
    assert found is not None
    names, order = [*result.inputs.groups], np.argsort(found.total)
    place = np.arange(len(order))
    for shift, values, interval, colour, label in (
        (0.2, found.total, found.total90, TOTAL, "total"),
        (-0.2, found.first, found.first90, FIRST, "first order"),
    ):
        axes.barh(place + shift, values[order], 0.4, xerr=_reach(values, interval)[:, order], color=colour, label=label)
    axes.set_yticks(place, [names[i] for i in order])
    axes.axvline(0, color="#1c2430", linewidth=0.8)
    axes.set(xlabel="share of the variance", title="Sobol indices")
    axes.legend(fontsize="small", loc="lower right")


def _morris(axes: Axes, result: SensitivityResult, column: int) -> None:
    found = result.screenings[column]
    assert found is not None
    order = np.argsort(found.mu_star)
    place = np.arange(len(order))
    reach = _reach(found.mu_star, found.mu_star90)[:, order]
    axes.barh(place, found.mu_star[order], 0.6, xerr=reach, color=TOTAL, label="mu*: mean absolute effect")
    axes.plot(found.sigma[order], place, "D", color=SIGMA, markersize=4, label="sigma: not additive, not linear")
    axes.set_yticks(place, [result.inputs.names[i] for i in order])
    axes.set(xlabel=f"over the whole range, {result.columns[column].unit}", title="Morris screening")
    axes.legend(fontsize="small", loc="lower right")


def _reach(values: np.ndarray, interval: np.ndarray) -> np.ndarray:
    """(2, n) how far the intervals reach to either side of the values."""
    return np.clip(np.stack([values - interval[:, 0], interval[:, 1] - values]), 0, None)
