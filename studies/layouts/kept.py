"""The result of a search that has ended, kept in its history: the same call answers without a simulation."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign import SIMULATOR, __version__
from fabdesign.kept_values import as_json, of_json
from fabdesign.metrics import Errors
from fabdesign.study_file import Study
from optimize.history import History
from optimize.start_rows import StartRow, of_rows
from studies.layouts.after import kept_fewer
from studies.layouts.begin import limits_of
from studies.layouts.loading_path import LoadingPath
from studies.layouts.reach import Reach
from studies.layouts.result import StudyResult
from studies.layouts.robustness import Robustness
from studies.layouts.target import LoadedTarget

VERSIONS = f"fabdesign {__version__}, simulator {SIMULATOR}"


@dataclass(frozen=True, eq=False)
class Kept:
    """What a result has beside its study, targets and history. seconds, evaluations: the limits that it was searched
    within; complete: whether a search within wider ones would end alike; follow: as `run_study` was asked."""

    versions: str
    seconds: float
    evaluations: int
    complete: bool
    follow: bool
    layout: dict[str, Any]  # optimize.start_rows
    points: NDArray[np.float64]
    rest: NDArray[np.float64]
    errors: Errors
    rest_errors: Errors
    constraints: dict[str, float]
    wall_s: float
    stop_reason: str
    reach: Reach
    loading_path: LoadingPath | None
    robust: Robustness | None
    within: float | None


_SHARED = {own.name for own in fields(Kept)} & {own.name for own in fields(StudyResult)}  # kept as they are


def keep(history: History, result: StudyResult, *, follow: bool) -> None:
    """Let the same call answer with this result."""
    study, state = result.study, history.load()
    if state is None:
        return
    kept = Kept(
        versions=VERSIONS,
        seconds=study.limits.seconds,
        evaluations=study.limits.evaluations,
        complete=bool(state.get("reason")) and study.robust is None and not (result.fewer and result.fewer.cut),
        follow=follow,
        layout={"muscles": [asdict(own) for own in result.design.muscles], "pressures": result.pressures.tolist()},
        **{name: getattr(result, name) for name in _SHARED},
    )
    history.keep_answer(as_json(kept))


def answer(history: History, study: Study, targets: Sequence[LoadedTarget], *, follow: bool) -> StudyResult | None:
    """The result that is kept, where a search within the study's limits would end with it; None where it may not."""
    try:
        kept = of_json(Kept, history.answer())
    except (KeyError, TypeError, ValueError, AttributeError):  # none, or of another version
        return None
    limits = study.limits
    as_far = kept.seconds >= limits.seconds and kept.evaluations >= limits.evaluations
    if kept.versions != VERSIONS or kept.follow != follow or not (kept.complete or as_far):
        return None
    row = StartRow(muscles=kept.layout["muscles"], pressures=kept.layout["pressures"])
    [(space, _)] = of_rows([row], study.design, limits_of(study))
    return StudyResult(
        study=study,
        design=space.design,
        pressures=space.start_pressures,
        targets=tuple(target.beside(shape) for target, shape in zip(targets, kept.points, strict=True)),
        history=tuple(history.entries()),
        **{name: getattr(kept, name) for name in _SHARED},
        fewer=kept_fewer(study, history.load()),
    )
