"""The lower edge from below: how far it stands out along its length, with the model's intervals as a band."""

from typing import Any

import numpy as np

from fabdesign.units import in_mm
from studies.studio.band import lower_edge
from studies.studio.session import Session

_SIZE, _LEFT, _BELOW = (340, 150), 38, 26  # pixels
_LEAST = 0.005  # m, the least height of the plot


class ProfilePanel:
    def __init__(self, gui: Any, session: Session) -> None:
        self._session = session
        self._plot = gui.add_html("")

    def show(self) -> None:
        shape = self._session.shapes.shown
        self._plot.content = "" if shape is None else self._drawn()

    def _drawn(self) -> str:
        session = self._session
        shape, band = session.shapes.shown, session.shapes.band
        assert shape is not None
        edge = lower_edge(shape.points)
        z = edge[:, 2]
        half = np.zeros_like(z) if band is None else band.half[:, 2]
        curves = [z - half, z + half]
        correction = shape.correction if shape.exact else None
        simulated = None
        if correction is not None and correction.moved(shape.points).any():
            simulated = lower_edge(correction.simulated)[:, 2]
            curves.append(simulated)
        low, high = (float(f(curves)) for f in (np.min, np.max))
        spare = max(_LEAST - (high - low), 0.1 * (high - low)) / 2
        plot = _Plot(len(z), low - spare, high + spare)
        parts = [plot.axes(in_mm(shape.layout.design.fabric.width))]
        said = "no intervals: the model has no joint covariance"
        if band is not None:
            parts.append(plot.band(z - half, z + half))
            said = f"band: 90 % intervals of the model, at most ±{in_mm(half.max()):.2f} mm"
        elif session.shapes.bands:
            said = "intervals follow the exact shape"
        if simulated is not None:
            parts.append(plot.line(simulated, "#e08a2b", dashed=True))
            said += "; orange: without the corrector"
        parts.append(plot.line(z, "#1b4f8a"))
        size = f'style="display:block" width="{_SIZE[0]}" height="{_SIZE[1]}"'
        svg = f'<svg id="studio-profile" {size}>{"".join(parts)}</svg>'
        return f'<div style="font-size:0.8em; margin:0.2em 0.9em">Lower edge, z in mm over u in mm{svg}{said}</div>'


class _Plot:
    """Values at even places, between two ends [m], in pixels."""

    def __init__(self, count: int, low: float, high: float) -> None:
        self._x = np.linspace(_LEFT, _SIZE[0] - 8, count)
        self._low, self._high = low, high

    def _y(self, values: Any) -> Any:
        return 6 + (_SIZE[1] - _BELOW - 6) * (self._high - values) / (self._high - self._low)

    def _points(self, values: Any) -> list[str]:
        return [f"{x:.1f},{y:.1f}" for x, y in zip(self._x, self._y(values), strict=True)]

    def line(self, values: Any, colour: str, *, dashed: bool = False) -> str:
        dash = ' stroke-dasharray="5 3"' if dashed else ""
        stroke = f'stroke="{colour}"{dash} stroke-width="1.6"'
        return f'<polyline points="{" ".join(self._points(values))}" fill="none" {stroke}/>'

    def band(self, low: Any, high: Any) -> str:
        outline = " ".join([*self._points(low), *reversed(self._points(high))])
        return f'<polygon points="{outline}" fill="#1b4f8a" fill-opacity="0.22"/>'

    def axes(self, width: float) -> str:
        """width: mm."""
        left, right, bottom = self._x[0], self._x[-1], _SIZE[1] - _BELOW
        text = 'font-size="11" fill="#3b4654"'
        lines = f'<path d="M{left} 6V{bottom}H{right}" stroke="#8a94a0" fill="none"/>'
        ends = [
            f'<text x="{left - 4}" y="{self._y(v) + 4:.0f}" text-anchor="end" {text}>{in_mm(v):.1f}</text>'
            for v in (self._low, (self._low + self._high) / 2, self._high)
        ]
        places = [
            f'<text x="{x:.0f}" y="{bottom + 15}" text-anchor="middle" {text}>{u:.0f}</text>'
            for x, u in ((left, 0.0), ((left + right) / 2, width / 2), (right - 6, width))
        ]
        return lines + "".join([*ends, *places])
