"""The forward models of a search and the stages in which it goes from the coarse one to the fine one."""

from collections.abc import Sequence

from fabdesign.nouns.forward import HOLD, RISE, ForwardModel
from fabdesign.nouns.model import POINTS_PER_SIDE
from fabdesign.nouns.predictor import Predictor
from fabdesign.study_files.study_file import Study
from optimize.search.evaluations import Stage
from optimize.search.objective import Objective
from optimize.search.slopes import jacobians_for
from studies.layout_search.target import LoadedTarget
from studies.prediction.forward_model import without_resistance

COARSE = 21  # points a side, of the simulator on which a search begins


def forward_models(
    fine: ForwardModel | None,
    coarse: ForwardModel | None,
    *,
    points_per_side: int = POINTS_PER_SIDE,
    rise: float = RISE,
    hold: float = HOLD,
    coarse_hold: float | None = None,
) -> tuple[ForwardModel, ForwardModel]:
    """Return the models given, or the simulator, the fine one with `points_per_side`; a single one given serves for
    both."""
    if fine is not None:
        return fine, coarse or fine
    from sim import Simulator  # here: it loads and starts taichi

    fine = Simulator(points_per_side, rise=rise, hold=hold)
    return fine, coarse or Simulator(
        COARSE, tolerance=1e-6, rise=rise, hold=hold if coarse_hold is None else coarse_hold
    )


def coarse_hold_of(study: Study, targets: Sequence[LoadedTarget]) -> float:
    """Return the seconds for which pressures hold where shapes at rest stand for frames of the targets
    (optimize.search.objective)."""
    times = [target.time for target in targets if target.time is not None]
    return study.hold if len(times) < len(targets) else min(study.hold, max(0.0, max(times) - study.rise))


def stages_of(study: Study, coarse: Predictor, fine: Predictor, objective: Objective) -> list[Stage]:
    """Return the stages. Slopes are those without forces against motion, where derivatives are known."""
    known = jacobians_for(coarse, objective) is not None
    bare = without_resistance(coarse) if known else None
    if study.muscles is not None:
        return [
            Stage("pressures of drawn layouts", coarse, keep=10, rounds=1, until=0.4, slopes=bare, at_rest=True),
            Stage("layouts", coarse, keep=4, rounds=4, vary_positions=study.positions, until=0.5, slopes=bare),
            Stage("best layouts", coarse, keep=2, rounds=12, vary_positions=study.positions, until=0.65, slopes=bare),
            Stage("full model", fine, keep=1, rounds=32, vary_positions=study.positions, slopes=bare or coarse),
        ]
    return [
        Stage("coarse model", coarse, keep=2, rounds=8, vary_positions=study.positions, until=0.5, slopes=bare),
        Stage("full model", fine, keep=2, rounds=8, vary_positions=study.positions, slopes=bare or coarse),
    ]
