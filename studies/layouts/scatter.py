"""How copies of a layout differ, and their shapes: simulated, or by derivatives.

A copy is a vector z of independent standard normals: shifts of every corner point, errors of every channel's pressure
and every muscle's gain, and what the model's joint covariance leaves open.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm, qmc

from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Column, Jacobians, corner
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import Ensemble
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.study_files.study_file import Study
from fabdesign.study_files.study_targets import Robust
from optimize.search.local_search import LinearShape
from optimize.search.objective import Objective, Poses
from optimize.search.slopes import refined_jacobians
from studies.prediction.forward_model import unresisted

STANDARD = "standard deviations"  # unit of a column
LINEAR_COPIES = 128  # of a layout, by derivatives; a power of two
Copy = tuple[Design, Array, Model]


@dataclass(frozen=True, eq=False)
class Scattering:
    """The scatter that a study asks for, and what shapes of copies are computed and valued with. objective: of one
    copy."""

    study: Study
    robust: Robust
    objective: Objective
    forward: Predictor

    def shapes(self, copies: Sequence[Copy]) -> list[Poses]:
        """Return the shapes of any layouts' copies, in one batch; a diverged one holds NaN."""
        layouts = [(design, pressures) for design, pressures, _ in copies]
        models = [replace(self.forward, model=model) for *_, model in copies]
        return self.objective.shapes(replace(self.forward, model=Model()), layouts, models)

    def case(self, pose: int, copy: Copy) -> Case:
        """Return a copy with all that its model adds but forces against motion, of which derivatives know nothing."""
        design, pressures, model = copy
        [case] = self.objective.cases(pose, [(design, pressures)])
        return replace(case, factors=dict(model.factors), effects=unresisted(model).terms)

    @property
    def jacobians(self) -> Jacobians | None:
        """Return what derivatives of such cases are asked of; None where the forward model has none."""
        return replace(self.forward, model=Model()).faces_jacobian


class Scatter:
    """How copies of one layout differ: `size` standard normals a copy."""

    def __init__(self, how: Scattering, design: Design, pressures: Array) -> None:
        self.how, self.design, self._pressures = how, design, pressures
        self._model = how.study.model or Model()
        self._ensemble = Ensemble(self._model if how.robust.covariance else replace(self._model, covariance=None))
        self._corners = [len(muscle.path) for muscle in design.muscles]
        self._channels = [muscle.channel for muscle in design.muscles]
        counts = 2 * sum(self._corners), design.channels, len(design.muscles), self._ensemble.size
        self._ends = np.cumsum(counts).tolist()
        self.size: int = self._ends[-1]

    def normals(self, stream: int = 0) -> Array:
        """Return (LINEAR_COPIES, size) of copies, even from the first few on. stream: of random numbers."""
        sequence = qmc.Sobol(self.size, rng=np.random.default_rng(self.how.study.seed + stream)).random(LINEAR_COPIES)
        return np.asarray(norm.ppf(sequence))

    def shifted(self, muscle: int, direction: Sequence[float], metres: float) -> Array:
        """Return (size,) of the copy of which one muscle, from 0, lies off its place."""
        z = np.zeros(self.size)
        first = 2 * sum(self._corners[:muscle])
        step = np.tile(np.asarray(direction) * metres, self._corners[muscle])
        z[first : first + 2 * self._corners[muscle]] = step / self.how.robust.placement
        return z

    def copy(self, z: Array) -> Copy:
        """Return one copy: its layout with a channel for each muscle, (poses, muscles) Pa that stand for its pressures
        and gains, and its model."""
        places, _, _, rest = np.split(z, self._ends[:-1])
        fabric = self.design.fabric
        shifts = np.split(self.how.robust.placement * places.reshape(-1, 2), np.cumsum(self._corners)[:-1])
        muscles = []
        for k, (muscle, shift) in enumerate(zip(self.design.muscles, shifts, strict=True)):
            moved = np.clip(np.array(muscle.path) + shift, 0.0, [fabric.width, fabric.height])
            muscles.append(replace(muscle, channel=k, path=tuple((float(u), float(v)) for u, v in moved)))
        pressures = np.maximum(0.0, self._pressures[:, self._channels] * self.pull(z))
        model = self._ensemble.at(rest) if len(rest) else self._model
        return replace(self.design, muscles=tuple(muscles)), pressures, model

    def pull(self, z: Array) -> Array:
        """Return (muscles,) factors of one copy on the muscles' pressures, which stand for its pressures and gains."""
        _, channels, gains, _ = np.split(z, self._ends[:-1])
        robust = self.how.robust
        return np.asarray((1 + robust.pressure * channels[self._channels]) * (1 + robust.muscle_gain * gains))

    def shapes(self, zs: Sequence[Array] | Array) -> list[Poses]:
        """Return the shapes of copies, in one batch; a diverged one holds NaN."""
        return self.how.shapes([self.copy(z) for z in zs])

    def values(self, zs: Sequence[Array] | Array) -> list[float]:
        """Return m of copies; infinite where one diverged."""
        return self.how.objective.values(self.shapes(zs))

    @property
    def resists(self) -> bool:
        """Return whether the model has forces against motion."""
        return unresisted(self._model) != self._model

    @property
    def columns(self) -> list[Column]:
        """Return how a case of `Scattering` changes with each of the `size` normals, from the layout as it should be.
        Muscles keep their number of intervals."""
        robust, count = self.how.robust, len(self.design.muscles)
        corners = [(m, k) for m, many in enumerate(self._corners) for k in range(many)]
        by_channel = np.equal.outer(np.arange(self.design.channels), self._channels) * robust.pressure
        return [
            *(_placed(m, k, way, robust.placement) for m, k in corners for way in ((1.0, 0.0), (0.0, 1.0))),
            *(_pulling(f"channel {k}", share) for k, share in enumerate(by_channel)),
            *(_pulling(f"muscle {k}", share) for k, share in enumerate(np.eye(count) * robust.muscle_gain)),
            *(self._of_model(k) for k in range(self._ensemble.size)),
        ]

    def _of_model(self, k: int) -> Column:
        def moved(case: Case, by: float) -> Case:
            model = self._ensemble.at(by * np.eye(self._ensemble.size)[k])
            return replace(case, factors=dict(model.factors), effects=unresisted(model).terms)

        return Column(f"covariance {k}", STANDARD, 0.2, 1.0, moved)

    def linear(self) -> tuple[LinearShape, bool]:
        """Return the shape of copies in their standard normals, about none: by derivatives of shapes at rest where the
        forward model offers them, else by differences of one standard deviation, in one batch. What diverges has no
        slope. And whether the tangent is definite, as it is on one branch; differences stand in where it is not."""
        targets, none = self.how.objective.targets, np.zeros(self.size)
        jacobians = self.how.jacobians if all(target.time is None for target in targets) else None
        definite = True
        if jacobians is None:
            nominal, *ahead = self.shapes([none, *np.eye(self.size)])
            slopes = np.array([shape - nominal for shape in ahead])
        else:
            columns, cases = self.columns, [self.how.case(k, self.copy(none)) for k in range(len(targets))]
            poses = [refined_jacobians(jacobians, [case], columns)[0] for case in cases]
            nominal, slopes = np.array([pose.points for pose in poses]), np.stack([pose.changes for pose in poses], 1)
            definite = all(bool(pose.exact.all()) for pose in poses)
            if self.resists:
                [nominal] = self.shapes([none])
        slopes[~np.isfinite(slopes).all(axis=(1, 2, 3))] = 0.0
        return LinearShape(none, nominal, slopes), definite


def _placed(muscle: int, index: int, along: tuple[float, float], placement: float) -> Column:
    """Return the column of a corner off its place, in standard deviations of so many m."""
    column = corner(muscle, index, along)

    def moved(case: Case, by: float) -> Case:
        return column.moved(case, by * placement)

    return Column(column.name, STANDARD, column.step / placement, column.far / placement, moved)


def _pulling(name: str, share: Array) -> Column:
    """Return the column of muscles' pressures, each on its own channel, by a share (muscles,) of them a standard
    deviation."""

    def moved(case: Case, by: float) -> Case:
        program = case.program
        return replace(
            case, program=PressureProgram(program.time, program.pressure * (1 + by * share), program.duration)
        )

    return Column(name, STANDARD, 0.2, 1.0, moved)
