"""The target beside the cloth: where it lies, and how far the cloth is from it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.distances import nearest_distances
from fabdesign.geometry.metrics import Errors, told_beyond
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.design import Design
from fabdesign.study_files.study_targets import TargetFile
from fabdesign.units import in_mm
from studies.layout_search.target import LoadedTarget, load_target, target_errors

DRAWS = 5  # of a floor: it stands beside each exact shape, and is good to a few hundredths of a millimetre
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ShownTarget:
    """A target as `optimize` takes it."""

    file: TargetFile
    loaded: LoadedTarget

    @staticmethod
    def read(file: TargetFile, design: Design) -> "ShownTarget":
        """Read a target. Raises InputError like `optimize`, also for a place where no cloth can be."""
        return ShownTarget(file, load_target(file, design))

    @property
    def points(self) -> Floats:
        """Return its points (n, 3) m."""
        return self.loaded.points


@dataclass(frozen=True, eq=False)
class Comparison:
    """A shape against the target. Distances in m."""

    errors: Errors
    of_target: Floats  # (n,) of each target point to the cloth's surface
    of_cloth: Floats  # (2 m,) of each point of the cloth to the nearest of the target

    @property
    def sentences(self) -> list[str]:
        """Return the errors in words, mm, with the noise floors beside."""
        e = self.errors
        message = [
            f"Chamfer {in_mm(e.chamfer):.2f} mm (noise floor {in_mm(e.chamfer_floor):.2f})",
            f"surface RMS {in_mm(e.surface_rms):.2f} mm (noise floor {in_mm(e.surface_floor):.2f})",
        ]
        return [*message, told_beyond(e.beyond)] if e.beyond else message


def compare(target: ShownTarget, shape: NDArray[np.float32], design: Design) -> Comparison:
    """Return how far a shape (2 n, 3) m is from a target."""
    errors = target_errors([target.loaded], shape[None].astype(np.float64), design, draws=DRAWS)
    return Comparison(errors, Surface.of_faces(shape).distance(target.points), nearest_distances(shape, target.points))


def placed_by_hand(file: TargetFile, rotation: Sequence[float], translation: Sequence[float]) -> TargetFile:
    """Place a target. rotation: degrees about the fixed axes x, y, z in this order; translation: m."""
    a, b, c = (round(float(x), 3) for x in rotation)
    x, y, z = (round(float(x), 6) for x in translation)
    return replace(file, rotation=(a, b, c) if any((a, b, c)) else None, translation=(x, y, z), place="given")
