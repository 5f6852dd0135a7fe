"""A page that turns and plays, with everything in it: open it without a network."""

import base64
import json
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from studies.report.page import drawn
from studies.view.items import Distance, Item, errors_in_words
from studies.view.shapes import CLOUD, OVERLAY, key_of, parts_of, points_beneath, vertices_of

LEVELS = 32_000  # a coordinate is stored as a whole number of the largest one's 32,000th: 10 um of 0.3 m
MOST_POINTS = 4_000  # of a frame that has no triangles: more look the same


def render_page(title: str, items: Sequence[Item], *, overlay: bool = False) -> str:
    """Return the HTML of the items side by side, with one time slider where something moves; points are rounded to the
    LEVELS-th part of the largest coordinate. overlay: whether over a panel lie the points of what it is compared with,
    until a click takes them away."""
    size = max(float(np.abs(frame).max(initial=0.0)) for item in items for frame in vertices_of(item))
    scale = max(size, 1e-6) / LEVELS
    titles = [item.title for item in items]
    packed = []
    for item in items:
        reference = None if item.apart is None else titles.index(item.apart.reference)
        packed.append({**_packed(item, scale), "apart": _compared(item.apart), "reference": reference})
    apart = any(item.apart is not None for item in items)
    data = {"scale": scale, "cloud": CLOUD, "overlay": OVERLAY, "items": packed}
    content = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    key = [
        (name, "rgb(" + ", ".join(f"{round(255 * share)}" for share in colour) + ")")
        for name, colour in key_of(items, overlay=apart)
    ]
    shown = {"moves": any(item.moves for item in items), "overlay": overlay, "compared": apart}
    return drawn("view/page.html.j2", title=title, items=items, data=Markup(content), key=key, **shown)


def _packed(item: Item, scale: float) -> dict[str, object]:
    """Return a panel for the page: coordinates as whole numbers, and what is drawn of them; of each vertex of the
    muscles' tubes the point of the cloth that it lies on."""
    kept = vertices_of(item)
    if item.triangles is None:
        kept = [frame[:: -(-len(frame) // MOST_POINTS)] for frame in kept]
    integers = [np.round(frame / scale).astype("<i2") for frame in kept]
    parts = parts_of(item)
    triangles = np.concatenate([np.zeros((0, 3), np.int64), *(part.triangles for part in parts)])
    return {
        "title": item.title,
        "times": [round(float(t), 6) for t in item.times],
        "counts": [len(frame) for frame in integers],
        "points": _base64(np.concatenate(integers)),
        "triangles": _base64(triangles.astype("<u4")),
        "beneath": _base64(points_beneath(item).astype("<u4")),
        "parts": [(3 * len(part.triangles), part.colour) for part in parts],
    }


def _compared(distance: Distance | None) -> dict[str, object] | None:
    """Return how far a panel is from another: a line an instant [s], and one of it all."""
    if distance is None:
        return None
    return {
        "reference": f"from {distance.reference}",
        "times": [round(float(t), 6) for t in distance.times],
        "lines": [errors_in_words(errors) for errors in distance.errors],
        "whole": f"{distance.when}: {errors_in_words(distance.overall)}" if distance.when else "",
    }


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
