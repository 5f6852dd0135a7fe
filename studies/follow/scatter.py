"""How sure a motion is: the program with other pressures and models, and where small changes lead to another side."""

from dataclasses import dataclass, replace

import numpy as np

from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import Ensemble
from fabdesign.nouns.pressure import PressureProgram, limits
from fabdesign.study_files.follow_file import MotionScatter
from studies.follow.wanted import Wanted
from studies.prediction.forward_model import forward_model
from studies.prediction.stability import instants_elsewhere, rms_of_each, to_either_side


@dataclass(frozen=True, eq=False)
class MotionCopies:
    """Motions beside the one that is meant. band (K,) m: half of the 90 % interval of the copies, RMS over the cloth.
    expected: m, the mean of their distances from what is wanted. snap: s, from when on small changes of the pressures
    lead to another stable shape; None where they do not."""

    number: int
    band: Array
    expected: float
    snap: float | None


def copies_of(
    simulator: ForwardModel, model: Model | None, case: Case, wanted: Wanted, scatter: MotionScatter, seed: int
) -> MotionCopies | None:
    """Return what copies of the case's motion come to, each with pressures off by the channel, and a model of the
    covariance where there is one. None where none is asked for, or the motion itself diverges."""
    if not scatter.copies:
        return None
    times, most = wanted.times, limits(case.design)
    rng = np.random.default_rng(seed)
    gains = 1 + scatter.pressure * rng.standard_normal((scatter.copies, len(most)))
    factors = [np.ones(len(most)), *to_either_side(case.design), *gains]
    cases = [replace(case, program=_scaled(case.program, row, most)) for row in factors]
    forward = forward_model(simulator, model)
    drawn = [] if model is None else Ensemble(model).drawn(scatter.copies, seed)
    alike = cases[: len(cases) - len(drawn)]
    meant, up, down, *copies = forward.motions(alike, [times] * len(alike))
    for one, drawn_case in zip(drawn, cases[len(alike) :], strict=True):
        copies += forward_model(simulator, one).motions([drawn_case], [times])
    sound = [copy for copy in copies if np.isfinite(copy).all()]
    if not np.isfinite(meant).all() or not sound:
        return None
    off = np.array([rms_of_each(copy - meant) for copy in sound])
    elsewhere = instants_elsewhere(meant, up, down)
    snap = float(times[int(np.argmax(elsewhere))]) if elsewhere.any() else None
    expected = float(np.mean([wanted.mean_distance(copy) for copy in sound]))
    return MotionCopies(len(sound), np.asarray(1.645 * np.sqrt(np.square(off).mean(axis=0))), expected, snap)


def _scaled(program: PressureProgram, gains: Array, most: Array) -> PressureProgram:
    return replace(program, pressure=np.clip(program.pressure * gains, 0.0, most))
