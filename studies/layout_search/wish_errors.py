"""Errors of a result in words, and beside wishes: what each asked for, and how far the cloth is from it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.metrics import Errors
from fabdesign.geometry.shape import Shape, at_places
from fabdesign.geometry.wishes import Landmarks
from fabdesign.nouns.fabric import Fabric
from fabdesign.study_files.study_file import Study
from fabdesign.study_files.study_targets import TargetFile
from fabdesign.units import in_mm

Array = NDArray[np.float64]


def is_wished(targets: Sequence[TargetFile]) -> bool:
    """Return whether all poses are wishes, so that there is no cloud and no noise."""
    return bool(targets) and all(target.wishes for target in targets)


def measure_of(study: Study) -> str:
    """Return the name of what a search makes small."""
    if is_wished(study.targets):
        return "distance from what was asked for"
    return "Chamfer distance" if study.objective == "chamfer" else "surface RMS"


def errors_in_words(study: Study, errors: Errors) -> str:
    """Return the errors of a result in mm, beside its objective."""
    if is_wished(study.targets):
        return f"mean distance from what was asked for; root mean square {in_mm(errors.surface_rms):.3f}"
    return f"Chamfer {in_mm(errors.chamfer):.3f}, noise floor {in_mm(errors.chamfer_floor):.3f}"


@dataclass(frozen=True)
class WishOutcome:
    """One wish beside a shape."""

    said: str
    mean: float  # m, over its places, in the coordinates that it gives
    largest: float
    weight: float


def asked_of(target: TargetFile, shape: Array, fabric: Fabric) -> list[WishOutcome]:
    """Return the wishes of a pose beside its shape (2 n, 3) m."""
    rows = []
    for wish in target.wishes:
        off = Landmarks.of([wish], fabric).distances(shape)
        rows.append(WishOutcome(wish.said, float(off.mean()), float(off.max()), wish.weight))
    return rows


def reached_and_asked(landmarks: Landmarks, shape: Array) -> tuple[Array, Array]:
    """Return the places of a shape (2 n, 3) m and where they were to come, (k, 3) m each: a coordinate that no wish
    gives is the shape's."""
    reached = np.asarray(at_places(Shape.of(shape).middle, landmarks.shares))
    return reached, np.where(landmarks.given, landmarks.goals, reached)
