"""Shapes of what is not sewn yet, of models drawn jointly, with what a model does not know as intervals; and which
measurement would narrow them most: expected information, linear and Gaussian.

About the model, shapes are linear in z, whose prior is the unit normal: a pose's shape is B z, a measurement's frames
are A z plus noise. After it z has covariance (1 + A^T A / noise^2)^-1, whatever is measured (Lindley 1956; Chaloner and
Verdinelli 1995), and the shape that times B on both sides."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import SimulationError
from fabdesign.files.pressure_file import constant_program
from fabdesign.geometry.shape import Shape, mean_curvature, tip
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import MUSCLE_TYPES, OF_MUSCLES, Case, ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import Ensemble, spread_of
from fabdesign.nouns.pressure import PressureProgram, RigLimits, standard_programs
from fabdesign.study_files.unseen_file import CandidateMeasurement, Unsewn
from fabdesign.units import in_kpa, in_mm
from optimize.fit.parameters import PRIOR
from studies.intervals.calibrate import shapes_with_error
from studies.prediction.stability import moves, snaps, to_either_side
from studies.unseen import result

STEP = 0.5  # of z, in differences


@dataclass(frozen=True, eq=False)
class Draws:
    """Independent standard normals z stand for a model: first its covariance's, then, for each number of a muscle type
    that the model does not have, the data sheet's prior."""

    model: Model
    design: Design

    @cached_property
    def unknown(self) -> tuple[str, ...]:
        """Return factors of the design's muscle types that the model says nothing of."""
        known = self.model.factors
        types = dict.fromkeys(muscle.type for muscle in self.design.muscles)
        names = [(f"{MUSCLE_TYPES}{kind}.{factor}", factor) for kind in types for factor in OF_MUSCLES]
        return tuple(name for name, factor in names if name not in known and factor not in known)

    @property
    def names(self) -> tuple[str, ...]:
        return (*self._ensemble.names, *self.unknown)

    @cached_property
    def _ensemble(self) -> Ensemble:
        return Ensemble(self.model)

    @property
    def steps(self) -> list[Array]:
        """Return +STEP and -STEP of each z in turn."""
        return [sign * STEP * row for row in np.eye(len(self.names)) for sign in (1, -1)]

    def case(self, z: Array, program: PressureProgram, design: Design | None = None) -> Case:
        """Return the case of (n,) z; on the design, or on another one."""
        count = self._ensemble.size
        model = self._ensemble.at(z[:count])
        names = zip(self.unknown, z[count:], strict=True)
        drawn = {name: float(np.exp(PRIOR[name.rpartition(".")[2]] * x)) for name, x in names}
        return Case(design or self.design, program, model.factors | drawn, model.terms)


_PERCENTILES = 5.0, 50.0, 95.0


def predicted(unsewn: Unsewn, draws: Draws, forward: ForwardModel, samples: int, seed: int) -> list[result.PoseResult]:
    """Return of each pose the shape's band, tip, mean curvature and the study's outputs over drawn models, and whether
    it snaps. mm, 1/m, degrees, kPa.

    band: m RMS over points that a drawn model's shape lies from their mean, in mm. A drawn shape has the error of a
    model with calibrated intervals too. Raises SimulationError where most
    models find no shape at rest.
    """
    rng, count = np.random.default_rng([seed, 5]), len(draws.names)
    zs = [np.zeros(count), *rng.normal(size=(samples, count))]
    factors = to_either_side(unsewn.design)
    cases = []
    for pose in unsewn.poses:
        cases += [draws.case(z, constant_program(pose)) for z in zs]
        cases += [draws.case(zs[0], constant_program(pose * factor)) for factor in factors]
    each, spread = len(zs) + len(factors), spread_of(unsewn.model)
    cases += [] if spread is None else [draws.case(zs[0], constant_program(np.zeros(unsewn.design.channels)))]
    shapes = [np.asarray(shape, float) for shape in forward.equilibria(cases)]

    def with_error(drawn: Array, predicted: Array) -> Array:
        """Add what the model lacks, where its intervals are calibrated."""
        if spread is None or not (np.isfinite(shapes[-1]).all() and np.isfinite(predicted).all()):
            return drawn
        least = 1.0 if draws.unknown else 0.0  # a tolerance of the data sheet was not calibrated
        return shapes_with_error(drawn, shapes[-1], predicted, spread, unsewn.design.fabric, rng, least=least)

    by_pose = [shapes[k * each : (k + 1) * each] for k in range(len(unsewn.poses))]
    return [_pose(unsewn, pose, some, with_error) for pose, some in zip(unsewn.poses, by_pose, strict=True)]


def _pose(
    unsewn: Unsewn, pose: Array, shapes: list[Array], with_error: Callable[[Array, Array], Array]
) -> result.PoseResult:
    """Return what there is to say of a pose's shapes: the model's own, those of drawn models, and the model's own under
    pressures that are off to either side."""
    *drawn, up, down = shapes
    sound = np.array([shape for shape in drawn[1:] if np.isfinite(shape).all()])
    if len(sound) < len(drawn) / 2:
        raise SimulationError(f"{unsewn.design.name}: most models find no shape at rest under {in_kpa(pose)} kPa")
    failed, sound = len(drawn) - 1 - len(sound), with_error(sound, drawn[0])
    away = np.sqrt(np.square(sound - sound.mean(axis=0)).sum(axis=-1))  # (models, points)
    tips = in_mm(np.array([tip(shape, unsewn.design.fabric) for shape in sound]))
    return result.PoseResult(
        pressures_kpa=in_kpa(pose).tolist(),
        band_mm=in_mm(float(np.sqrt(np.square(away).mean()))),
        widest_mm=in_mm(float(np.sqrt(np.square(away).mean(axis=0)).max())),
        tip_mm={axis: _percentiles(tips[:, k]) for k, axis in enumerate("xyz")},
        outputs={
            output.text: result.OutputSpread(output.unit, _percentiles(np.array([output.of(s) for s in sound])))
            for output in unsewn.outputs
        },
        mean_curvature=_percentiles(np.array([mean_curvature(shape) for shape in sound])),
        failed=failed,
        snaps=bool(snaps(moves(drawn[0], up, down)[None])[0]),
        middle=np.round(Shape(sound).middle[:, :, 20, [2, 1]], 6).tolist(),  # z and y
    )


def _percentiles(values: Array) -> result.Percentiles:
    """Return 5 %, middle, 95 %."""
    return [float(x) for x in np.percentile(values, _PERCENTILES)]


def intervals_statement(model: Model) -> str:
    """Return what the shapes' intervals are from, in words."""
    spread = spread_of(model)
    if spread is None:
        changed = "; the model was changed since its intervals were calibrated" if model.spread else ""
        return f"intervals are from the model's joint covariance alone, not calibrated on measured motions{changed}"
    return (
        f"intervals are calibrated on {spread.trials} measured trials of other designs or programs, of which "
        f"{spread.held:.0%} were inside when left out: joint covariance, and what the model lacks"
    )


def corrector_reach(model: Model, unsewn: Unsewn) -> result.CorrectorReach:
    """Return whether the model's corrector applies to the design."""
    if model.corrector is None:
        return result.CorrectorReach(None, "no corrector in this model")
    from corrector.field import load_corrector  # here: it loads the weights

    trust = load_corrector(model).trust(unsewn.design)
    far = f"{trust.distance:.2f} from the designs that it learned from, its limit is {trust.limit:.2f}"
    statement = f"the corrector applies: {far}" if trust.applies else f"the corrector does not apply: {far}"
    return result.CorrectorReach(trust.applies, statement, trust.distance, trust.limit)


FRAMES = 6  # of a measurement
NOISE = 1e-3  # m a coordinate: the sensor's and what the model cannot follow
IN_TURN = 3  # measurements that are proposed together
INDEPENDENT = 40  # points of a frame: what the model cannot follow is smooth over the cloth
_THIN = 8  # every so many-th point


def slopes(shapes: Sequence[NDArray[np.float32]], each: int) -> list[Array]:
    """Return (values, n) m by z, of every `each` = 2 n shapes at +STEP and -STEP of each z in turn; every few
    points."""
    flat = [np.asarray(shape[..., ::_THIN, :], float).ravel() for shape in shapes]
    ways = [(up - down) / (2 * STEP) for up, down in zip(flat[::2], flat[1::2], strict=True)]
    return [np.stack(ways[k : k + each // 2], axis=1) for k in range(0, len(ways), each // 2)]


def information(candidates: Sequence[CandidateMeasurement], draws: Draws, forward: ForwardModel) -> list[Array]:
    """Return (n, n) A^T A / noise^2 of each candidate's motion; NaN where one diverged."""
    cases = [draws.case(z, c.program, c.design) for c in candidates for z in draws.steps]
    times = [c.program.duration * (np.arange(FRAMES) + 1) / FRAMES for c in candidates for _ in draws.steps]
    return [
        a.T @ a * (INDEPENDENT / (len(a) / 3 / FRAMES)) / NOISE**2
        for a in slopes(forward.motions(cases, times), len(draws.steps))
    ]


def spread(b: Array, covariance: Array) -> float:
    """Return the RMS [m] over points, of shapes B z with z of this covariance."""
    return float(np.sqrt(3 * np.einsum("ij,jk,ik->i", b, covariance, b).mean()))


def after(b: Array, gained: Array) -> float:
    """Return the RMS [m] of what a measurement of this information leaves of the shapes' spread."""
    return spread(b, np.asarray(np.linalg.inv(np.eye(len(gained)) + gained)))


def in_turn(b: Array, gained: Mapping[str, Array], count: int) -> dict[str, float]:
    """Return at most `count` measurements, each the one that tells most beside those before it, and m RMS that they
    leave together. gained: (n, n), what `information` says of each."""
    chosen: dict[str, float] = {}
    known = np.zeros((b.shape[1], b.shape[1]))
    while len(chosen) < min(count, len(gained)):
        remaining = {name: after(b, known + information) for name, information in gained.items() if name not in chosen}
        best = min(remaining, key=lambda name: remaining[name])
        chosen[best], known = remaining[best], known + gained[best]
    return chosen


def measurement(
    unsewn: Unsewn, draws: Draws, forward: ForwardModel, candidates: Sequence[CandidateMeasurement]
) -> result.Measurement:
    """Return what each measurement would leave of the shapes' spread, and which tell most together."""
    cases = [draws.case(z, constant_program(pose)) for pose in unsewn.poses for z in draws.steps]
    b = np.concatenate(slopes(forward.equilibria(cases), len(draws.steps)))  # all poses one after another
    by_name = {candidate.name: candidate for candidate in candidates}
    gained = dict(zip(by_name, information(candidates, draws, forward), strict=True))
    gained = {name: matrix for name, matrix in gained.items() if np.isfinite(matrix).all()}
    remaining = {name: in_mm(after(b, matrix)) for name, matrix in gained.items()}
    ranked = sorted(remaining, key=lambda name: remaining[name])
    program = None
    if ranked:
        best = by_name[ranked[0]].program
        program = result.SetPoints(best.time.tolist(), in_kpa(best.pressure).round(3).tolist(), best.duration)
    return result.Measurement(
        spread_mm=in_mm(spread(b, np.eye(len(draws.names)))),
        due_to_mm={name: in_mm(spread(b[:, k : k + 1], np.eye(1))) for k, name in enumerate(draws.names)},
        candidates={name: result.RankedMeasurement(by_name[name].design.name, remaining[name]) for name in ranked},
        program=program,
        in_turn_mm={name: in_mm(value) for name, value in in_turn(b, gained, IN_TURN).items()},
    )


def candidates_of(unsewn: Unsewn, rig: RigLimits) -> list[CandidateMeasurement]:
    """Return the study's measurements; else steps, staircases and ramps on the design that the rig can do."""
    if unsewn.candidates:
        return [*unsewn.candidates]
    named = standard_programs(unsewn.design, rig)
    return [CandidateMeasurement(name, unsewn.design, program) for name, program in named.items()]
