"""How far the shapes of two panels are apart, with the noise floor: what side by side alone does not say."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.clouds.cloud_file import POINTS
from fabdesign.errors import InputError
from fabdesign.geometry.distances import chamfer
from fabdesign.geometry.metrics import Errors, frame_errors, mean_errors
from fabdesign.geometry.sensor_noise import NOISE_FREE, SensorNoise, estimate_noise
from fabdesign.geometry.shape import Shape
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.array import Array
from fabdesign.units import in_mm
from studies.view.items import Item

INSTANTS = 40  # of a motion, at most
_NOISE_FRAMES = 8  # that a sensor's noise is estimated from
_FEWEST = 800  # points of a cloth's cloud, under which a curved cloth looks like noise


@dataclass(frozen=True, eq=False)
class Distance:
    """The distance from a panel to the one it is compared with, at `times` (K,) s. NaN in errors: not known."""

    reference: str
    times: Array
    errors: tuple[Errors, ...]  # m
    both_move: bool

    @property
    def overall(self) -> Errors:
        """Return the errors of the motion: the mean of two that move, else the last."""
        return mean_errors(self.errors) if self.both_move else self.errors[-1]

    @property
    def when(self) -> str:
        """Return what `overall` is of; empty between still shapes."""
        return "" if len(self.times) == 1 else "mean of the motion" if self.both_move else "at the motion's end"

    def json_content(self) -> dict[str, object]:
        """Return the distance as JSON, in mm; null: not known."""
        return {"from": self.reference, "of": self.when or "still shapes", "unit": "mm", **self.overall.millimetres()}


def errors_in_words(errors: Errors) -> str:
    """Return the distances in words."""
    floors = np.isfinite(errors.chamfer_floor)

    def figure(value: float, floor: float) -> str:
        return f"{in_mm(value):.2f} mm" + (f" (noise floor {in_mm(floor):.2f})" if floors else "")

    text = f"Chamfer {figure(errors.chamfer, errors.chamfer_floor)}"
    if np.isfinite(errors.surface_rms):
        text += f", surface RMS {figure(errors.surface_rms, errors.surface_floor)}"
    return text


def distances(items: Sequence[Item]) -> list[Distance | None]:
    """Return the distance of every panel to the first one, of a prediction to what it predicts; None of what others are
    compared with."""
    by_title = {item.title: item for item in items}
    compared: list[Distance | None] = []
    for item in items:
        reference = by_title.get(item.predicts, items[0])
        compared.append(None if reference is item else _distance(reference, item))
    return compared


def _distance(reference: Item, item: Item) -> Distance:
    both_move = item.moves and reference.moves
    times = item.times if item.moves or not reference.moves else reference.times
    times = times[np.unique(np.linspace(0, len(times) - 1, min(INSTANTS, len(times))).astype(int))]
    pairs = [(_frame(reference, t), _frame(item, t)) for t in times]
    if not item.is_cloth and not reference.is_cloth:
        errors = [
            Errors(chamfer(*(p[:: -(-len(p) // POINTS)] for p in pair)), np.nan, np.nan, np.nan) for pair in pairs
        ]
        return Distance(reference.title, times, tuple(errors), both_move)
    seen, model = zip(*(pair if item.is_cloth else pair[::-1] for pair in pairs), strict=True)
    source = reference if item.is_cloth else item
    noise = NOISE_FREE if source.triangles is not None else _noise(seen, model[0])
    errors = frame_errors(seen, np.array(model), noise or NOISE_FREE)
    if noise is None:
        errors = [Errors(e.chamfer, np.nan, e.surface_rms, np.nan) for e in errors]
    return Distance(reference.title, times, tuple(errors), both_move)


def _frame(item: Item, time: float) -> Array:
    """Return (n, 3) m: its points as a sensor would give them; of a mesh that is no cloth even draws over its area."""
    points = np.asarray(item.frames[item.nearest(time)], np.float64)
    if item.triangles is None or item.is_cloth:
        return points
    return Surface(points, item.triangles).sample(POINTS, np.random.default_rng(0))[0]


def _noise(clouds: Sequence[Array], model: Array) -> SensorNoise | None:
    """Return the noise of the sensor that saw a cloth; None where the clouds have too few points to say."""
    if np.median([len(cloud) for cloud in clouds]) < _FEWEST:
        return None
    front, back = Shape.of(model).faces
    thickness = float(np.median(np.linalg.norm(front - back, axis=-1)))
    chosen = np.unique(np.linspace(0, len(clouds) - 1, min(_NOISE_FRAMES, len(clouds))).astype(int))
    try:
        return estimate_noise([clouds[k] for k in chosen], thickness)
    except InputError:
        return None
