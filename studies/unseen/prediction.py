"""Shapes of what is not sewn yet, with what the model does not know as intervals."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import SimulationError
from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import spread_of
from fabdesign.study_files.unseen_file import Unsewn
from fabdesign.units import in_kpa, in_mm
from studies.intervals.band import shapes_with_error
from studies.prediction.stability import moves, snaps, to_either_side
from studies.sensitivity.outputs import mean_curvature, tip
from studies.unseen.draws import Draws
from studies.unseen.result import CorrectorStatement, Percentiles, PoseResult

Array = NDArray[np.float64]
_PERCENTILES = 5.0, 50.0, 95.0


def predicted(unsewn: Unsewn, draws: Draws, forward: ForwardModel, samples: int, seed: int) -> list[PoseResult]:
    """Of each pose: the shape's band, tip, mean curvature and the study's outputs over drawn models, and whether it
    snaps. mm, 1/m, degrees, kPa.

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
    own, spread = len(zs) + len(factors), spread_of(unsewn.model)
    cases += [] if spread is None else [draws.case(zs[0], constant_program(np.zeros(unsewn.design.channels)))]
    shapes = [np.asarray(shape, float) for shape in forward.equilibria(cases)]

    def with_error(drawn: Array, predicted: Array) -> Array:
        """What the model lacks too, where its intervals are calibrated."""
        if spread is None or not (np.isfinite(shapes[-1]).all() and np.isfinite(predicted).all()):
            return drawn
        least = 1.0 if draws.unknown else 0.0  # a tolerance of the data sheet was not calibrated
        return shapes_with_error(drawn, shapes[-1], predicted, spread, unsewn.design.fabric, rng, least=least)

    return [
        _pose(unsewn, pose, shapes[k * own : k * own + len(zs)], shapes[k * own + len(zs) : (k + 1) * own], with_error)
        for k, pose in enumerate(unsewn.poses)
    ]


def _pose(
    unsewn: Unsewn, pose: Array, drawn: list[Array], off: list[Array], with_error: Callable[[Array, Array], Array]
) -> PoseResult:
    sound = np.array([shape for shape in drawn[1:] if np.isfinite(shape).all()])
    if len(sound) < len(drawn) / 2:
        raise SimulationError(f"{unsewn.design.name}: most models find no shape at rest under {in_kpa(pose)} kPa")
    failed, sound = len(drawn) - 1 - len(sound), with_error(sound, drawn[0])
    away = np.sqrt(np.square(sound - sound.mean(axis=0)).sum(axis=-1))  # (models, points)
    tips = in_mm(np.array([tip(shape, unsewn.design.fabric) for shape in sound]))
    return {
        "pressures_kpa": in_kpa(pose).tolist(),
        "band_mm": in_mm(float(np.sqrt(np.square(away).mean()))),
        "widest_mm": in_mm(float(np.sqrt(np.square(away).mean(axis=0)).max())),
        "tip_mm": {axis: _percentiles(tips[:, k]) for k, axis in enumerate("xyz")},
        "outputs": {
            output.text: {"unit": output.unit, "percentiles": _percentiles(np.array([output.of(s) for s in sound]))}
            for output in unsewn.outputs
        },
        "mean_curvature": _percentiles(np.array([mean_curvature(shape) for shape in sound])),
        "failed": failed,
        "snaps": bool(snaps(moves(drawn[0], *off)[None])[0]),
        "middle": np.round(_column(sound), 6).tolist(),
    }


def _column(shapes: Array) -> Array:
    """(models, 41, 2) m: z and y down the cloth's middle line."""
    faces = shapes.reshape(len(shapes), 2, 41, 41, 3).mean(axis=1)
    return np.asarray(faces[:, :, 20, [2, 1]])


def _percentiles(values: Array) -> Percentiles:
    """5 %, middle, 95 %."""
    return [float(x) for x in np.percentile(values, _PERCENTILES)]


def intervals_statement(model: Model) -> str:
    """What the shapes' intervals are from, in words."""
    spread = spread_of(model)
    if spread is None:
        changed = "; the model was changed since its intervals were calibrated" if model.spread else ""
        return f"intervals are from the model's joint covariance alone, not calibrated on measured motions{changed}"
    return (
        f"intervals are calibrated on {spread.trials} measured trials of other designs or programs, of which "
        f"{spread.held:.0%} were inside when left out: joint covariance, and what the model lacks"
    )


def corrector_statement(model: Model, unsewn: Unsewn) -> CorrectorStatement:
    """Whether the model's corrector applies to the design, and in words."""
    if model.corrector is None:
        return {"applies": None, "said": "no corrector in this model"}
    from corrector.field import load_corrector  # here: it loads the weights

    trust = load_corrector(model).trust(unsewn.design)
    far = f"{trust.distance:.2f} from the designs that it learned from, its limit is {trust.limit:.2f}"
    statement = f"the corrector applies: {far}" if trust.applies else f"the corrector does not apply: {far}"
    return {"applies": trust.applies, "distance": trust.distance, "limit": trust.limit, "said": statement}
