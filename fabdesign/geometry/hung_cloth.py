"""Where a cloud can be a cloth that hangs: what cannot be is named.

A sheet keeps its size within a few percent, so that no point lies farther from the held places than on the flat cloth.
A pinned edge bears no moment: at rest the cloth's centre lies straight below it, whatever the muscles do.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import SIDE
from fabdesign.units import in_mm

Array = NDArray[np.float64]

_STRETCH = 1.15  # of the flat cloth's lengths: more than its weight and its muscles do
_SMALL = 0.3  # of the held length, that the cloud spans at least
_OFF = 0.1  # of the shorter side: how far from the held places its nearest points may lie in the mean
# the same for nine tenths of the held places, 1.5 times as far; of a cloud about as large as the cloth, whose unit is
# therefore right, the ends of the edge may be bent in as far as a half tube's
_BENT_IN, _WHOLE = 0.3, 0.8  # of the shorter side; of the diagonal
_CLOSE = 0.1  # of the shorter side: a centre so near the held edge has no direction
# degrees between gravity and the way from the held edge to the centre: 18 at most in the synthetic rigs' motions;
# exchanged axes make 90 or more, less what the shape itself leans: a half tube by one of its straight edges makes 57
_LEANING = {"pinned": 60.0, "clamped": 100.0}


def misplaced(points: Array, fabric: Fabric, *, part: bool = False, free: bool = False) -> str | None:
    """Return what about a cloud (n, 3) m a cloth held as `fabric` could not do, as "..., expected ..."; None: nothing.

    Of a cloth that nothing holds the size alone is checked; of a cloud that shows a part, size and reach;
    of a free one the size.
    """
    held, flat = held_places(fabric), at_rest(fabric, 5, 5)
    short = min(fabric.width, fabric.height)
    span = float(np.linalg.norm(np.ptp(np.quantile(points, [0.01, 0.99], axis=0), axis=0)))
    largest = float(np.hypot(fabric.width, fabric.height))
    if span > _STRETCH * largest * np.sqrt(3):  # of a box in any frame
        return f"it is {_length(span)} across; expected at most {_length(largest)}, the cloth's diagonal"
    if free or not len(held):
        return None
    if not part and span < _SMALL * np.linalg.norm(np.ptp(held, axis=0)):
        return f"it is {_length(span)} across; expected a cloth held along {_length(fabric.width)}"
    tree = cKDTree(held)
    reached, farthest = float(np.quantile(tree.query(points)[0], 0.98)), float(tree.query(flat)[0].max())
    if reached > _STRETCH * farthest + _OFF * short:
        return f"it reaches {_length(reached)} from where the cloth is held; expected at most {_length(farthest)}"
    if part:
        return None
    spacing = np.sqrt(fabric.width * fabric.height / len(points))
    gaps = cKDTree(points).query(held)[0]
    ends = (_BENT_IN if span >= _WHOLE * largest else 1.5 * _OFF) * short
    if gaps.mean() > _OFF * short + 2 * spacing or np.quantile(gaps, 0.9) > ends + 2 * spacing:
        gap = _length(float(gaps.mean()))
        return f"it lies {gap} from where the cloth is held, in the mean; expected points along all of that edge"
    down = np.array(fabric.gravity)
    hangs, lies = points.mean(axis=0) - held.mean(axis=0), flat.mean(axis=0) - held.mean(axis=0)
    if degrees_between(lies, down) > 30 or np.linalg.norm(hangs) < _CLOSE * short:
        return None  # held elsewhere, or rolled up at the edge
    if (angle := degrees_between(hangs, down)) > _LEANING[fabric.support]:
        return f"its centre lies {angle:.0f} degrees off gravity, seen from the held edge; expected a cloth that hangs"
    return None


@lru_cache
def held_places(fabric: Fabric) -> Array:
    """Return (n, 3) m, places that are held, of the cloth at rest; none for `hung = "none"`."""
    if fabric.hung == "none":
        return np.zeros((0, 3))
    if isinstance(fabric.hung, tuple):
        u, v = np.array(fabric.hung).T
        return np.stack([u - fabric.width / 2, -v, 0 * u], axis=1)
    rows = at_rest(fabric, SIDE, SIDE).reshape(SIDE, SIDE, 3)
    return {"top": rows[0], "bottom": rows[-1], "left": rows[:, 0], "right": rows[:, -1]}[fabric.hung]


def at_rest(fabric: Fabric, across: int, down: int) -> Array:
    """Return (down across, 3) m, places spread evenly over the flat cloth, by rising v, then rising u."""
    u, v = np.meshgrid(np.linspace(0, fabric.width, across), np.linspace(0, fabric.height, down))
    return on_flat_cloth(np.stack([u.ravel(), v.ravel()], axis=1), fabric)


def on_flat_cloth(places: Array, fabric: Fabric) -> Array:
    """Return (n, 3) m: places (u, v) (n, 2) m of the flat cloth."""
    return np.stack([places[:, 0] - fabric.width / 2, -places[:, 1], 0 * places[:, 0]], axis=1)


def degrees_between(a: Array, b: Array) -> float:
    """Return the angle between two directions; 0 where one has no length."""
    lengths = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip(a @ b / lengths, -1.0, 1.0)))) if lengths else 0.0


def _length(metres: float) -> str:
    return f"{metres:.4g} m" if metres >= 1 else f"{in_mm(metres):.3g} mm"
