"""The target beside the cloth: where it lies, how far the cloth is from it; and one that moves, with a program."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.geometry.distances import nearest_distances
from fabdesign.geometry.metrics import Errors, told_beyond
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.study_files.follow_file import FollowStudy
from fabdesign.study_files.study_targets import TargetFile
from fabdesign.units import in_mm
from studies.follow.programs import Regulator, regulator_of
from studies.follow.target import wanted_of
from studies.follow.wanted import Wanted
from studies.layout_search.target import LoadedTarget, load_target, target_errors
from studies.prediction.predict import frame_times

DRAWS = 5  # of a floor: it stands beside each exact shape, and is good to a few hundredths of a millimetre
FRAME_RATE = 30.0  # Hz, of a motion that is played
POINTS = 500  # of each cloud of a target that moves
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


@dataclass(frozen=True, eq=False)
class MovingProgram:
    """A study of a target that moves, and set points (cycles, channels) Pa for it."""

    study: FollowStudy
    wanted: Wanted
    regulator: Regulator
    pressures: Floats

    @staticmethod
    def of(study: FollowStudy) -> "MovingProgram":
        """Return the study under the program that it begins with, or at rest. Raises InputError."""
        if not study.design.muscles:
            raise InputError(f"{study.name}: no layout yet; expected the folder of the study's result")
        wanted, regulator = wanted_of(study).thinned(POINTS), regulator_of(study)
        rest = np.zeros((regulator.cycles(float(wanted.times[-1])), regulator.channels))
        moving = MovingProgram(study, wanted, regulator, rest)
        return moving if study.start is None else moving.under(study.start)

    def under(self, program: PressureProgram) -> "MovingProgram":
        """Return the same under another program, as far as the regulator goes with it."""
        return replace(self, pressures=self.regulator.kept(self.regulator.rows(program, len(self.pressures))))

    @cached_property
    def times(self) -> Floats:
        """Return the instants (T,) s that are shown: those that are wanted, and others where they are far apart."""
        wanted = self.wanted.times
        between = frame_times(self.regulator.program(self.pressures), frame_rate=FRAME_RATE)[1:]
        apart = np.abs(between[:, None] - wanted).min(axis=1) > 0.5 / FRAME_RATE
        return np.sort(np.concatenate([wanted, between[apart & (between < wanted[-1])]]))

    @cached_property
    def clouds(self) -> list[Floats]:
        """Return what is wanted at each of these instants, or next (n_t, 3) m."""
        return [self.wanted.targets[k].points for k in np.searchsorted(self.wanted.times, self.times - 1e-9)]
