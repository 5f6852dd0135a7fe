"""The errors of docs/errors.md: Chamfer and surface RMS, their floors, and what share of a gap is closed.

With `measured.splits`, the only place where these are computed. Chamfer: unsquared, each way the mean, both ways
summed. Everything in m; people are shown mm.
"""

from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass, fields
from functools import partial
from itertools import islice
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fabdesign.formats.schema import Key, Millimetre
from fabdesign.geometry.distances import ChamferTo
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.geometry.shape import Face
from fabdesign.geometry.surface import CAP, Nearest, Surface, capped_rms, half_of
from fabdesign.geometry.wishes import Landmarks, Weighting
from fabdesign.nouns.array import Floats
from fabdesign.units import in_mm

DRAWS = 20  # of a floor


@dataclass(frozen=True)
class Errors:
    """m. A frame's, or the means over the frames of a trial."""

    chamfer: Millimetre
    chamfer_floor: Millimetre
    surface_rms: Millimetre
    surface_floor: Millimetre
    # share of the measured points farther off than the cap, which count as if they were at it
    beyond: Annotated[float, Key("surface_beyond")] = 0.0

    @property
    def excess(self) -> float:
        """Return m of surface RMS over its floor, in quadrature; 0 within it."""
        return over(self.surface_rms, self.surface_floor)

    def millimetres(self) -> dict[str, float]:
        """Return the four errors by name, mm."""
        return {name: in_mm(value) for name, value in asdict(self).items() if name != "beyond"}


def over(rms: float, floor: float) -> float:
    """Return what an RMS has over its floor, in quadrature; 0 within it."""
    return float(np.sqrt(max(rms**2 - floor**2, 0.0)))


def mean_errors(each: Sequence[Errors]) -> Errors:
    """Return m, the mean of every error."""
    return Errors(*np.mean([astuple(errors) for errors in each], axis=0).tolist())


def surface_rms(measured: Floats, model: Floats, face: Face = "both", weighting: Weighting | None = None) -> float:
    """Return the root mean square [m] of the distances of measured points (n, 3) to the faces of a model frame (2 rows
    cols, 3), or to one of them.

    Each distance, to the nearest triangle, is capped at 10 mm. weighting: how much the places count that they go to.
    """
    return capped_rms(*_distances(Surface.of_faces(model, face=face), measured, weighting, within=CAP))


def distance_to_faces(markers: Floats, model: Floats, face: Face = "both", weighting: Weighting | None = None) -> float:
    """Return the mean distance [m] of a few markers (n, 3) to the faces of a model frame (2 rows cols, 3), or to one of
    them, one way and uncapped.

    In place of Chamfer: most of the model has no marker near it.
    """
    return _mean(Surface.of_faces(model, face=face), weighting, markers)


def chamfer_to(model: Floats, face: Face = "both", weighting: Weighting | None = None) -> ChamferTo:
    """Return what measures clouds against the points of a model frame (2 rows cols, 3) m, or of one of its faces."""
    weights = None if weighting is None else half_of(weighting.of_points(len(model)), face)
    return ChamferTo(half_of(model, face), weights)


def _distances(
    surface: Surface, points: Floats, weighting: Weighting | None, *, within: float = np.inf
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (n,) m to a surface of a cloth, and the shares (n,) of the points in a mean; infinite beyond `within` at
    most."""
    if weighting is None:
        return surface.distance(points, within=within), np.full(len(points), 1 / len(points))
    nearest = surface.nearest(points)
    return nearest.distance, shares_at(surface, nearest, weighting)


def _mean(surface: Surface, weighting: Weighting | None, points: Floats) -> float:
    """Return m, uncapped."""
    off, shares = _distances(surface, points, weighting)
    return float(off @ shares)


def shares_at(surface: Surface, nearest: Nearest, weighting: Weighting | None) -> NDArray[np.float64]:
    """Return (n,) of the places nearest to points on a surface of a cloth, in a mean over the points; they sum to 1."""
    if weighting is None:
        return np.full(len(nearest.distance), 1 / len(nearest.distance))
    at_corners = weighting.of_points(len(surface.vertices))[surface.triangles[nearest.triangle]]
    weights = np.einsum("nk,nk->n", nearest.weights, at_corners)
    return np.asarray(weights / weights.sum())


def landmark_errors(landmarks: Landmarks, model: Floats) -> Errors:
    """Return the errors of one frame (2 rows cols, 3) m beside wishes: their mean distance in place of Chamfer, root
    mean square in place of surface RMS. Nothing is sampled and nothing measured: the floors are 0, and no distance is
    capped."""
    if not np.isfinite(model).all():
        return Errors(*[np.nan] * 5)
    off = landmarks.distances(model)
    rms = float(np.sqrt(landmarks.weights @ np.square(off)))
    return Errors(landmarks.mean(model), 0.0, rms, 0.0, 0.0)


@dataclass(frozen=True)
class CloudKind:
    """A kind of cloud: what it shows of a cloth. markers: `distance_to_faces` in place of Chamfer. face: the one that
    they show. weighting: how much each place of the cloth counts, in the floors too."""

    markers: bool = False
    face: Face = "both"
    weighting: Weighting | None = None


BOTH_FACES = CloudKind()


def trial_errors(
    measured: Sequence[Floats],
    predicted: Floats,
    noise: SensorNoise,
    kind: CloudKind = BOTH_FACES,
    *,
    seed: int = 0,
    draws: int = DRAWS,
) -> Errors:
    """Return means over the frames of a trial: T measured clouds (n_t, 3) m against a motion (T, 2 rows cols, 3) m. The
    floors' draws are spread evenly over the frames. A motion that diverged (NaN) has NaN errors."""
    if not np.isfinite(predicted).all():
        return Errors(*[np.nan] * 5)
    distances, floors = _by_frame(measured, predicted, noise, kind, seed, draws)
    (c, s, beyond), (c_floor, s_floor) = np.mean(distances, axis=0), np.mean(floors, axis=0)
    return Errors(float(c), float(c_floor), float(s), float(s_floor), float(beyond))


def frame_errors(measured: Sequence[Floats], predicted: Floats, noise: SensorNoise) -> list[Errors]:
    """Return of every frame what `trial_errors` takes the means of; all with the floors of the whole trial."""
    distances, floors = _by_frame(measured, predicted, noise, BOTH_FACES, 0, DRAWS)
    c_floor, s_floor = np.mean(floors, axis=0).tolist()
    return [Errors(c, c_floor, s, s_floor, beyond) for c, s, beyond in distances]


def _by_frame(
    measured: Sequence[Floats], predicted: Floats, noise: SensorNoise, kind: CloudKind, seed: int, draws: int
) -> tuple[list[tuple[float, float, float]], list[tuple[float, float]]]:
    """Return Chamfer, surface RMS and share beyond the cap of every frame; Chamfer and surface RMS of every draw."""
    if len(measured) != len(predicted):
        raise ValueError(f"{len(measured)} measured frames, {len(predicted)} predicted")
    rng = np.random.default_rng(seed)
    per_frame = np.bincount(np.arange(draws) * len(measured) // draws, minlength=len(measured))
    counts = np.repeat([len(cloud) for cloud in measured], per_frame).tolist()
    offsets = iter(noise.stray_offsets(counts, rng))
    distances, floors = [], []
    for cloud, model, repeats in zip(measured, predicted, per_frame, strict=True):
        surface, weighting = Surface.of_faces(model, face=kind.face), kind.weighting
        to_model = partial(_mean, surface, weighting) if kind.markers else chamfer_to(model, kind.face, weighting).of
        off, shares = _distances(surface, cloud, weighting, within=CAP)
        distances.append((to_model(cloud), capped_rms(off, shares), float(shares @ (off > CAP))))
        for strays in islice(offsets, repeats):
            drawn = noise.draw(surface, len(cloud), rng, strays)
            floors.append((to_model(drawn), capped_rms(*_distances(surface, drawn, weighting, within=CAP))))
    return distances, floors


MANY_BEYOND = 0.05  # share of the points from which on a capped figure hides how far off they are


def beyond_in_words(share: float) -> str:
    """Say how many points lie beyond the cap, and what that means where they are many."""
    sentence = f"{share:.1%} of the points lie more than {in_mm(CAP):g} mm off"
    return sentence + ("; the surface RMS is capped there, so the real error is larger" if share >= MANY_BEYOND else "")


@dataclass(frozen=True)
class Statistics:
    """The statistics of one error over trials, m (of `beyond` a share). std: that of the trials themselves (ddof 0)."""

    mean: float
    max: float
    min: float
    std: float

    @staticmethod
    def of(values: NDArray[np.floating[Any]]) -> "Statistics":
        """Return the statistics of (n,) values, one or more."""
        return Statistics(float(values.mean()), float(values.max()), float(values.min()), float(values.std()))


def statistics(trials: Sequence[Errors]) -> dict[str, Statistics]:
    """Return each error's statistics over trials; those that diverged are left out. At least one must be left. NaN of
    an error that no trial has, such as the surface RMS of points without an order."""
    table = np.array([astuple(errors) for errors in trials])
    known = np.isfinite(table)
    columns = table[known[:, known.any(axis=0)].all(axis=1)].T
    return {field.name: Statistics.of(column) for field, column in zip(fields(Errors), columns, strict=True)}


@dataclass(frozen=True)
class Closed:
    """Share of the error over the floor that a better model closes; None where there is none."""

    surface: float | None  # of the excess of the surface RMS: the one figure by which models are compared
    chamfer: float | None  # beside it
    json_keys: ClassVar = "surface", "chamfer", ("value", "surface")


def closed(before: Errors, after: Errors) -> Closed:
    """Return 1 - e_after / e_before, with the excess e = sqrt(surface_rms^2 - surface_floor^2); of Chamfer, (before -
    after) / (before - floor).

    The floors are those of `after`, the surface closer to the truth. Points without an order have no surface.
    """
    gap = before.chamfer - after.chamfer_floor
    excess_before, excess_after = (over(errors.surface_rms, after.surface_floor) for errors in (before, after))
    return Closed(
        surface=1 - excess_after / excess_before if excess_before > 0 else None,
        chamfer=(before.chamfer - after.chamfer) / gap if gap > 0 else None,
    )
