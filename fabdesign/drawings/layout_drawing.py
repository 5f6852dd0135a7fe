"""A layout drawn flat, one face beside the other, as SVG."""

from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.pressure import LARGEST
from fabdesign.units import in_kpa

if TYPE_CHECKING:
    from fabdesign.nouns.design import Design

SCALE = 1000.0  # drawing units a metre
GAP, TOP = 30.0, 26.0
STYLE = """<style>
.layout .cloth { fill: #f5f6f8; stroke: #9aa5b1; } .layout .hung { stroke: #1c2430; stroke-width: 4; }
.layout .muscle { fill: none; stroke-width: 5; stroke-linecap: round; }
.layout .label { fill: #fff; fill-opacity: .85; }
.layout .pressure { font: 600 11px system-ui, sans-serif; text-anchor: middle; fill: #1c2430; }
.layout .face { font: 13px system-ui, sans-serif; fill: #46505d; }
</style>"""
LEAST = 205.0  # of a panel: what the words above it need
# colours (RGB) of no pressure, of half and of the highest
LOW, HALF, HIGH = np.array([198, 219, 239]), np.array([253, 174, 97]), np.array([203, 24, 29])


def pressure_colour(share: float) -> str:
    """Return the CSS colour of a share of the highest pressure."""
    low, high, t = (LOW, HALF, 2 * share) if share < 0.5 else (HALF, HIGH, 2 * share - 1)
    red, green, blue = (low + np.clip(t, 0, 1) * (high - low)).astype(int)
    return f"rgb({red},{green},{blue})"


def layout_svg(design: "Design", pressures: NDArray[np.float64] | None = None, highest: float = LARGEST) -> str:
    """Return both faces as seen from the front. pressures (channels,) Pa; `highest` Pa has the strongest colour."""
    width, height = design.fabric.width * SCALE, design.fabric.height * SCALE
    step = max(width, LEAST) + GAP
    parts = []
    for panel, side in enumerate(("front", "back")):
        parts.append(f'<g transform="translate({panel * step},{TOP})">')
        parts.append(f'<text x="0" y="-8" class="face">{side}{", seen through the cloth" if panel else ""}</text>')
        parts.append(f'<rect width="{width:.1f}" height="{height:.1f}" class="cloth"/>')
        parts.append(f'<line x1="0" y1="0" x2="{width:.1f}" y2="0" class="hung"/>')
        for number, muscle in enumerate(design.muscles):
            if muscle.side == side:
                at = np.array(muscle.path) * SCALE
                text, colour = str(number), pressure_colour(0.5)
                if pressures is not None:
                    pressure = pressures[muscle.channel]
                    text, colour = f"{number}: {in_kpa(pressure):.0f}", pressure_colour(pressure / highest)
                parts += _muscle(number, at, (text, colour), width)
        parts.append("</g>")
    box = f"-4 0 {2 * step - GAP + 8:.1f} {height + TOP + 6:.1f}"
    name = escape(design.name)
    return f'<svg viewBox="{box}" class="layout" role="img" aria-label="{name}">{STYLE}{"".join(parts)}</svg>'


def _muscle(number: int, path: NDArray[np.float64], label: tuple[str, str], width: float) -> list[str]:
    points = " ".join(f"{u:.1f},{v:.1f}" for u, v in path)
    u, v = path[0] + (path[-1] - path[0]) * (0.3 + 0.4 * (number % 2))
    text, colour = label
    half = 3.4 * len(text)
    u = min(max(u, half), max(width - half, half))  # within the cloth
    return [
        f'<polyline points="{points}" class="muscle" stroke="{colour}"/>',
        f'<rect x="{u - half:.1f}" y="{v - 8:.1f}" width="{2 * half:.1f}" height="15" rx="4" class="label"/>',
        f'<text x="{u:.1f}" y="{v + 3.5:.1f}" class="pressure">{text}</text>',
    ]
