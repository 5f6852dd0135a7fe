"""Shapes at rest beside what was measured of them: a column, by the forces' tangent, costs a tenth of a motion.

Where a cloth stands is seen in its clouds alone: small places of a frame are where they were a moment before.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from fabdesign.effects.registry import EFFECTS
from fabdesign.files.trial_file import TrialData
from fabdesign.geometry.shape import Shape
from fabdesign.nouns.array import Array, Floats, Indices
from fabdesign.nouns.column import Column, Jacobians, of_effect
from fabdesign.nouns.fabric import SWING
from fabdesign.nouns.forward import Case
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.nouns.trial import Accuracy, Trial
from optimize.fit.clouds import Match, Sample, match
from optimize.fit.parameters import FitVector
from optimize.fit.problem import Evaluation, InputErrors, Linearisation, Problem, columns

_STEP, _FAR = 0.007, 0.15  # of a prior's deviation, of a column, and of the differences of what sensors add

_OTHER_BRANCH = 4.0  # times the usual residual of a shape; those of one side lie within 1.5


@dataclass(frozen=True, eq=False)
class Standing:
    """A cloth that stands: its points, in one cloud, and the pressures that are held, (channels,) Pa."""

    sample: Sample
    pressure: Array


@dataclass(frozen=True, eq=False)
class RestProblem(Problem):
    """Shapes at rest. jacobians: a forward model's, which gives the shapes too: near a snap another way to them may
    lead to another one. accuracy: of the inputs; None: they are exact."""

    standing: Sequence[Standing]
    jacobians: Jacobians
    vector: FitVector
    accuracy: Accuracy | None = None

    @property
    def samples(self) -> Sequence[Sample]:  # type: ignore[override]
        return [one.sample for one in self.standing]

    def evaluate(self, xs: Sequence[Array]) -> list[Evaluation]:
        at_rest = self.jacobians([case for x in xs for case in self._cases(x)], [])
        shapes, count = [one.points for one in at_rest], len(self.standing)
        return [self._evaluation(x, shapes[k * count : (k + 1) * count]) for k, x in enumerate(xs)]

    def linearise(
        self, evaluation: Evaluation, along: Array, old: Array | None = None, fresh: Indices | None = None
    ) -> Linearisation:
        """Return the shapes with all columns, whatever `along`, `old` and `fresh` are, since they cost little. NaN for
        shapes near a snap, where the forces have no tangent that holds them."""
        there, table = self._columns(evaluation.x, [_column(self.vector, k) for k in range(len(evaluation.x))])
        return self.with_jacobian(there, self.moving(table))

    def input_errors(self, evaluation: Evaluation) -> InputErrors | None:
        """Return what errors of the pressures and of the frame's level do, to first order."""
        if self.accuracy is None:
            return None
        channels = max(len(one.pressure) for one in self.standing)
        tilts = [of_effect("frame_tilt", axis, 0.01) for axis in ("about_x", "about_z")]
        _, table = self._columns(evaluation.x, [*map(_share_of_pressure, range(channels)), *tilts])
        deviations = np.array([self.accuracy.pressure] * channels + [self.accuracy.tilt] * len(tilts))
        return InputErrors(table * deviations, np.zeros(len(table)))

    def _cases(self, x: Array) -> list[Case]:
        factors, terms = self.vector.factors_at(x), self.vector.terms_at(x)
        pairs = [(one.sample.trial, PressureProgram(np.zeros(1), one.pressure[None], 1.0)) for one in self.standing]
        return [Case(trial.design, program, factors, terms, trial.order) for trial, program in pairs]

    def _columns(self, x: Array, moved: Sequence[Column]) -> tuple[Evaluation, Array]:
        """Return the shapes, and (N, k) m how each residual changes with columns."""
        at_rest = self.jacobians(self._cases(x), moved)
        there = self._evaluation(x, [one.points for one in at_rest])
        # the mid-surface is linear in the faces, so their changes are those of a sheet of one frame
        return there, columns(there, [Shape(_solved(one.changes)).middle[:, None] for one in at_rest])

    def _evaluation(self, x: Array, shapes: Sequence[Floats]) -> Evaluation:
        motions = [np.asarray(points)[None] for points in shapes]
        misfit = _without_other_branches(match(self.samples, motions))
        return Evaluation(x, misfit, [Shape(points) for points in motions])


def _without_other_branches(misfit: Match) -> Match:
    """Return the residuals, NaN for a shape that ends far off where most are near: on another side than the measured
    one, which no small change of the unknowns mends."""
    _, shape = np.unique(misfit.sample, return_inverse=True)
    squares = np.bincount(shape, np.square(np.nan_to_num(misfit.residual))) / np.bincount(shape)
    other = squares > _OTHER_BRANCH**2 * np.median(squares)
    return replace(misfit, residual=np.where(other[shape], np.nan, misfit.residual))


def _solved(changes: Floats) -> Floats:
    """Return (k, 2 n, 3) m with zeros for a column that alone is not solved: it moves next to nothing, such as that of
    a muscle without pressure."""
    lost = ~np.isfinite(changes).all(axis=(1, 2))
    return changes if np.all(lost) else np.where(np.reshape(lost, (-1, 1, 1)), 0.0, changes)


def _column(vector: FitVector, k: int) -> Column:
    """Return an unknown of a vector as a column; a case's terms are the vector's, behind those that a model has."""
    parameter = vector.parameters[k]
    label, _, key = parameter.name.rpartition(".")
    term = None if parameter.is_factor else vector.labels.index(label) - len(vector.terms)

    def x_of(case: Case) -> float:
        if term is None:
            return parameter.unknown(case.factors.get(parameter.name, 1.0))
        return parameter.unknown(case.effects[term].values[key])

    def moved(case: Case, by: float) -> Case:
        value = parameter.value(x_of(case) + by)
        if term is None:
            return replace(case, factors={**case.factors, parameter.name: value})
        effects = [*case.effects]
        effects[term] = replace(effects[term], values={**effects[term].values, key: value})
        return replace(case, effects=tuple(effects))

    def room(case: Case) -> tuple[float, float]:
        low, high = parameter.limits
        return low - x_of(case), high - x_of(case)

    return Column(
        parameter.name, "1", _STEP * parameter.deviation, _FAR * parameter.deviation, moved, room, differences=False
    )


def _share_of_pressure(channel: int) -> Column:
    """Return the column of a channel's pressure, by shares of it; a case without that channel stays as it is."""

    def moved(case: Case, by: float) -> Case:
        pressure = case.program.pressure.copy()
        pressure[:, channel : channel + 1] *= 1 + by
        return replace(case, program=replace(case.program, pressure=pressure))

    return Column(f"share of pressure {channel}", "1", 1e-3, 0.01, moved)


def acting_at_rest(vector: FitVector) -> FitVector:
    """Return the factors, and the terms without a force of their own, a clock or a memory, all off at the start."""
    effects = [EFFECTS[term.name] for term in vector.terms]
    still = [e.force is None and e.clock is None and not e.remembers for e in effects]
    fewer, _ = vector.only([label for label, acts in zip(vector.labels, still, strict=True) if acts])
    begun = tuple(p if p.is_factor else replace(p, start=0.0) for p in fewer.parameters)
    return replace(fewer, parameters=begun)


HELD = 0.3  # s that it must stand at the end of constant pressures: a swing stops for a moment where it turns
AHEAD = 0.13  # s between the frames that are compared
PLACES, POINTS = 60, 60  # of a frame, and points of each
CLOUD = 400  # points of a shape


def standing_of(trial: Trial, data: TrialData, noise: float, rng: np.random.Generator) -> Iterator[Standing]:
    """Yield a shape of a trial for each stretch under constant pressures at whose end the cloth stands: the rest of its
    swing, its speed over SWING, is within the `noise` [m] of a point."""
    pressure = data.program.at(data.time)
    changed = np.concatenate([[True], (pressure[1:] != pressure[:-1]).any(axis=1)])
    for stretch in np.split(np.arange(len(data.time)), np.flatnonzero(changed)[1:]):
        frames = stretch[data.time[stretch] > data.time[stretch[-1]] - HELD - 1e-6]
        span = float(data.time[frames[-1]] - data.time[frames[0]])
        if span >= 0.9 * HELD and _speed([data.frames[k] for k in frames], span) <= SWING * noise:
            yield _shape(trial, data, frames, rng)


def _speed(frames: Sequence[Floats], span: float) -> float:
    """Return the speed, m/s: RMS over frames within `span` s, and over places of the cloth, along their normals. It
    includes the noise's part."""
    ahead = min(max(1, round(AHEAD * (len(frames) - 1) / span)), len(frames) - 1)
    trees = [KDTree(np.asarray(cloud, dtype=float)) for cloud in frames]
    moved = [_moved(one, other) for one, other in zip(trees, trees[ahead:], strict=False)]
    return float(np.sqrt(np.mean(np.square(moved)))) * (len(frames) - 1) / (ahead * span)


def _moved(one: KDTree, other: KDTree) -> float:
    """Return how far another cloud's mean lies off along the normal, m, RMS over places of a cloud."""
    points = min(POINTS, one.n, other.n)
    seeds = one.data[np.linspace(0, one.n - 1, min(PLACES, one.n)).astype(int)]
    patch = one.data[one.query(seeds, k=points)[1].reshape(len(seeds), -1)]
    middle = patch.mean(axis=1)
    normal = np.linalg.svd(patch - middle[:, None], full_matrices=False)[2][:, -1]
    there = other.data[other.query(middle, k=points)[1].reshape(len(seeds), -1)].mean(axis=1)
    return float(np.sqrt(np.mean(np.square(np.einsum("nd,nd->n", there - middle, normal)))))


def _shape(trial: Trial, data: TrialData, frames: Indices, rng: np.random.Generator) -> Standing:
    """Return the shape of the frames (k,) in which a cloth stands."""
    cloud = np.concatenate([np.asarray(data.frames[k], dtype=float) for k in frames])
    chosen = cloud[rng.choice(len(cloud), min(CLOUD, len(cloud)), replace=False)]
    at: Array = data.time[frames[-1:]]
    return Standing(Sample(trial, at, (chosen,)), data.program.at(at)[0])
