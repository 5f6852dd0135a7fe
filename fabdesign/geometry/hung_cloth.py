"""Where clouds can lie: on a cloth that is held at its hung edge and hangs from it; what cannot be is named.

A sheet keeps its size within a few percent, so that no point lies farther from the held places than on the flat cloth.
A pinned edge bears no moment: at rest the cloth's centre lies straight below it, whatever the muscles do. Of a trial
axes exchanged, an axis turned round, another unit or another origin are refused, with the likely cause.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from fabdesign.errors import InputError
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import SIDE
from fabdesign.units import from_mm, in_mm

STRETCH = 1.15  # of the flat cloth's lengths: more than its weight and its muscles do
_SMALL = 0.3  # of the held length, that the cloud spans at least
_OFF = 0.1  # of the shorter side: how far from the held places its nearest points may lie in the mean
# the same for nine tenths of the held places, 1.5 times as far; of a cloud about as large as the cloth, whose unit is
# therefore right, the ends of the edge may be bent in as far as a half tube's
_BENT_IN, _SPREAD = 0.3, 0.8  # of the shorter side; of the diagonal
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
    if span > STRETCH * largest * np.sqrt(3):  # of a box in any frame
        return f"it is {_length(span)} across; expected at most {_length(largest)}, the cloth's diagonal"
    if free or not len(held):
        return None
    if not part and span < _SMALL * np.linalg.norm(np.ptp(held, axis=0)):
        return f"it is {_length(span)} across; expected a cloth held along {_length(fabric.width)}"
    tree = cKDTree(held)
    reached, farthest = float(np.quantile(tree.query(points)[0], 0.98)), float(tree.query(flat)[0].max())
    if reached > STRETCH * farthest + _OFF * short:
        return f"it reaches {_length(reached)} from where the cloth is held; expected at most {_length(farthest)}"
    if part:
        return None
    spacing = np.sqrt(fabric.width * fabric.height / len(points))
    gaps = cKDTree(points).query(held)[0]
    ends = (_BENT_IN if span >= _SPREAD * largest else 1.5 * _OFF) * short
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


_FRAMES = 6  # looked at, evenly over the trial
_EARLY = 0.2  # s after rest, before which a cloth has hardly moved
# degrees between gravity and the way from the hung edge to the middle of the cloth. A pinned cloth's centre hangs below
# its edge: 13 at most over all frames of the synthetic rigs; exchanged axes make it about 90, a turned one 180.
_ALONG = 30.0  # degrees, within which the flat cloth itself must hang for that to be asked
_MIDDLE = 0.15  # of the cloth's height: a tight roll's centre is too near the edge to have a direction
_HELD = 0.25  # of the cloth's shorter side: three quarters of the hung edge have a point nearer than that
_ABOVE = 0.25  # of the shorter side above the hung edge, where ...
_BEYOND = 0.2  # ... no more than this share of the points may be
_SPANNED = 0.5  # of the hung edge, that the points span at least: it is held straight
_ACROSS = 1.3  # of the cloth's diagonal: elastic cloth that muscles shorten
_REACH = 1.5  # of the farthest place of the flat cloth from the hung edge

# what may have been done to the points -> what takes it back
_CAUSES: Mapping[str, Callable[[Array], Array]] = {
    "is y turned round?": lambda p: p * [1, -1, 1],
    "are y and z exchanged?": lambda p: p[:, [0, 2, 1]],
    "are y and z exchanged, with z down?": lambda p: p[:, [0, 2, 1]] * [1, -1, 1],
    "are x and y exchanged?": lambda p: p[:, [1, 0, 2]],
    "are x and y exchanged, with x to the left?": lambda p: p[:, [1, 0, 2]] * [1, -1, 1],
    "are x and z exchanged?": lambda p: p[:, [2, 1, 0]],
    "are they in millimetres?": from_mm,
    "are they in inches?": lambda p: p * 0.0254,
    "are they in centimetres?": lambda p: p * 1e-2,
    "were millimetres taken to metres twice?": in_mm,
}


def require_on_cloth(frames: Sequence[Array], time: Array, fabric: Fabric, where: str) -> None:
    """Raise InputError unless clouds (n_t, 3) m, at `time` (T,) s after rest, can be those of a cloth hung as `fabric`.

    A cloth that nothing holds (`hung = "none"`) is not checked.
    """
    hung = held_places(fabric)
    if len(hung) == 0:
        return
    chosen = np.unique(np.linspace(0, len(frames) - 1, _FRAMES).round().astype(int))
    clouds = [frames[i] for i in chosen]
    early = bool(time[0] <= _EARLY)
    middle = np.mean([np.median(cloud, axis=0) for cloud in (clouds[:1] if early else clouds)], axis=0)
    leaning = _LEANING["pinned" if early else fabric.support]
    points = np.concatenate(clouds)
    fault = _fault(points, middle, hung, fabric, leaning)
    if fault is None:
        return

    def likely(points: Array, middle: Array) -> bool:
        """Return whether points are what such a cloth gives most often: a likely reading, not just a possible one."""
        below = float(np.linalg.norm(middle - hung.mean(axis=0))) >= _MIDDLE * min(fabric.width, fabric.height)
        return below and _fault(points, middle, hung, fabric, _ALONG) is None

    for cause, undone in _CAUSES.items():
        if likely(undone(points), undone(middle[None])[0]):
            raise InputError(f"{where}: {fault} ({cause})")
    moved = at_rest(fabric, 5, 5).mean(axis=0) - middle
    if likely(points + moved, middle + moved):
        off = in_mm(float(np.linalg.norm(moved)))
        raise InputError(f"{where}: {fault} (does its frame start elsewhere? the middle is {off:.0f} mm off)")
    raise InputError(f"{where}: {fault}")


def _fault(points: Array, middle: Array, hung: Array, fabric: Fabric, leaning: float) -> str | None:
    """Return what points (n, 3) m with the given middle cannot be, and what was expected; None where all is well."""
    flat, short = at_rest(fabric, 5, 5), min(fabric.width, fabric.height)
    spans = np.ptp(np.quantile(points, [0.02, 0.98], axis=0), axis=0)
    span, across, diagonal = float(spans.max()), float(np.linalg.norm(spans)), np.hypot(fabric.width, fabric.height)
    held = float(np.linalg.norm(np.ptp(hung, axis=0)))
    if span < _SPANNED * held:
        return f"the points span {in_mm(span):.3g} mm; expected a cloth held along {in_mm(held):.0f} mm"
    to_edge = cKDTree(hung)
    farthest = float(to_edge.query(flat)[0].max())
    reached = float(np.quantile(to_edge.query(points)[0], 0.9))
    if reached > _REACH * farthest:
        return (
            f"points lie {in_mm(reached):.0f} mm from where the cloth is held; expected {in_mm(farthest):.0f} at most"
        )
    if across > _ACROSS * diagonal:
        return f"the points are {in_mm(across):.0f} mm across; expected the cloth's diagonal, {in_mm(diagonal):.0f} mm"
    sparse = 2 * np.sqrt(fabric.width * fabric.height / len(points))  # of points drawn by chance, the widest gaps
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)  # built twice as fast, for few questions
    gap = float(np.quantile(tree.query(hung)[0], 0.75))
    if gap > max(_HELD * short, sparse):
        return f"no point within {in_mm(gap):.0f} mm of where the cloth is held; expected some along all of it"
    gravity = np.array(fabric.gravity)
    hangs, lies = middle - hung.mean(axis=0), flat.mean(axis=0) - hung.mean(axis=0)
    if degrees_between(lies, gravity) > _ALONG:
        return None
    angle, far = degrees_between(hangs, gravity), np.linalg.norm(hangs) >= _MIDDLE * short
    if far and angle > leaning:
        return f"the cloth lies {angle:.0f} degrees off gravity, seen from where it is held; expected it to hang"
    height = (hung.mean(axis=0) - points) @ gravity / np.linalg.norm(gravity)
    if np.mean(height > _ABOVE * short) > _BEYOND:
        return f"{100 * np.mean(height > 0):.0f} % of the points lie above where the cloth is held; expected it to hang"
    return None
