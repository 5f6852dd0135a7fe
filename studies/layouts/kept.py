"""A result as the history of its search keeps it, so that the same call answers at once; and what makes two calls the
same."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Literal, get_type_hints

from fabdesign.formats.json_file import exact, of_exact
from fabdesign.runtime.fingerprint import content_of
from fabdesign.study_files.study_file import Study
from fabdesign.units import in_kpa
from fabdesign.version import SIMULATOR, __version__
from optimize.search.history import History
from optimize.search.search_state import of_row
from studies.layout_search.target import LoadedTarget
from studies.layouts.refinement import kept_fewer
from studies.layouts.result import StudyResult

VERSIONS = f"fabdesign {__version__}, simulator {SIMULATOR}"
_MADE_AGAIN = ("study", "design", "pressure", "targets", "history", "fewer", "kept")
_KEPT = [field.name for field in fields(StudyResult) if field.name not in _MADE_AGAIN]  # as they are
_RAISED = ("limits.seconds", "limits.evaluations")  # without another result up to there
STARTS_OF_POSES = 2  # raised where a search of several poses no longer begins where it did, so that none goes on
_NO_MATTER = ("name", "targets", "outputs")  # the targets' points count, not their files
_ABSENT = ("limits.contraction", "limits.channels", "limits.air")  # where there is no such limit


def study_content(study: Study, targets: Sequence[LoadedTarget]) -> dict[str, str]:
    """Return field (`limits.spacing`, `design.fabric.thickness`, `target.points`) to value, as text; pressures in
    kPa."""
    more: dict[str, Any] = {"limits.pressure": [in_kpa(pressure) for pressure in study.limits.pressure]}
    if len(targets) > 1:
        more["starts"] = STARTS_OF_POSES
    if study.start_pressures is not None:
        more["start_pressures"] = in_kpa(study.start_pressures).tolist()
    for number, target in enumerate(targets, start=1):
        name = "target" if len(targets) == 1 else f"target {number}"
        more |= {f"{name}.time": target.time, f"{name}.weight": target.weight, f"{name}.points": target.sha256}
        further = {
            "distances": target.markers and "from markers, one way",
            "wishes": target.landmarks and target.landmarks.key,
            "free": target.free,
            "regions": target.weighting and repr(target.weighting.regions),
            "face": target.face != "both" and target.face,
        }
        more |= {f"{name}.{key}": value for key, value in further.items() if value}
    content = content_of(study, _NO_MATTER, more).items()
    return {name: value for name, value in content if name not in _RAISED and (name not in _ABSENT or value != "None")}


# of the layout that a search ended with: its shape at rest alone, or the motion that leads there too
Verification = Literal["at rest", "motion"]


def keep(history: History, result: StudyResult) -> None:
    """Let the same call answer with this result: what it has beside its study, targets and history, the limits that it
    was searched within, and whether a search within wider ones would end alike (`complete`)."""
    study, state = result.study, history.load()
    if state is None:
        return
    kept = {
        "versions": VERSIONS,
        "seconds": study.limits.seconds,
        "evaluations": study.limits.evaluations,
        "complete": bool(state.get("reason")) and study.robust is None and not (result.fewer and result.fewer.cut),
        "follow": result.loading_path is not None,
        "layout": {"muscles": result.design.muscles, "pressures": result.pressure.tolist()},
    }
    history.keep_answer(exact(kept | {name: getattr(result, name) for name in _KEPT}))


def answer(
    history: History, study: Study, targets: Sequence[LoadedTarget], verification: Verification
) -> StudyResult | None:
    """Return the result that is kept, where a search within the study's limits would end with it; None where it may
    not."""
    kept, limits, kinds = history.answer(), study.limits, get_type_hints(StudyResult)
    try:
        as_far = kept["seconds"] >= limits.seconds and kept["evaluations"] >= limits.evaluations
        if (
            kept["versions"] != VERSIONS
            or kept["follow"] != (verification == "motion")
            or not (kept["complete"] or as_far)
        ):
            return None
        space, _ = of_row(kept["layout"], study.design, study.limits)
        values = {name: of_exact(kinds[name], kept[name]) for name in _KEPT}
    except (KeyError, TypeError, ValueError, AttributeError):  # none, or of another version
        return None
    return StudyResult(
        study=study,
        design=space.design,
        pressure=space.start_pressures,
        targets=tuple(target.beside(shape) for target, shape in zip(targets, values["points"], strict=True)),
        history=tuple(history.entries()),
        **values,
        fewer=kept_fewer(study, history.load()),
        kept=True,
    )
