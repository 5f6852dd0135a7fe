"""A page that turns and plays, with everything in it: open it without a network."""

import base64
import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment
from markupsafe import Markup

from studies.view.items import Item

LEVELS = 32_000  # a coordinate is stored as a whole number of the largest one's 32,000th: 10 um of 0.3 m
MOST_POINTS = 4_000  # of a frame that has no triangles: more look the same


def render_page(title: str, items: Sequence[Item]) -> str:
    """HTML of the items side by side, with one time slider; points are rounded to the LEVELS-th part of the largest
    coordinate."""
    size = max(float(np.abs(frame).max(initial=0.0)) for item in items for frame in item.frames)
    scale = max(size, 1e-6) / LEVELS
    data = {"scale": scale, "items": [_packed(item, scale) for item in items]}
    template = Environment(autoescape=True).from_string(
        files("studies.view").joinpath("page.html.j2").read_text(encoding="utf-8")
    )
    content = json.dumps(data, separators=(",", ":")).replace("</", "<\\/")
    return template.render(title=title, items=items, data=Markup(content))


def _packed(item: Item, scale: float) -> dict[str, Any]:
    kept = [_thinned(frame) if item.triangles is None else np.asarray(frame) for frame in item.frames]
    whole = [np.round(frame / scale).astype("<i2") for frame in kept]
    triangles = np.zeros((0, 3)) if item.triangles is None else item.triangles
    return {
        "title": item.title,
        "times": [round(float(t), 6) for t in item.times],
        "counts": [len(frame) for frame in whole],
        "points": _base64(np.concatenate(whole)),
        "triangles": _base64(triangles.astype("<u4")),
    }


def _thinned(frame: np.ndarray) -> np.ndarray:
    return frame[:: -(-len(frame) // MOST_POINTS)]


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
