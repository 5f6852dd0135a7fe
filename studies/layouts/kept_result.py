"""The content that a search depends on, and the result of one that has ended, kept in its history: the same call
answers without a simulation."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, get_type_hints

from fabdesign.runtime.exact_values import as_json, of_json
from fabdesign.runtime.fingerprint import content_of
from fabdesign.study_files.study_file import Study
from fabdesign.units import in_kpa
from fabdesign.version import SIMULATOR, __version__
from optimize.search.history import History
from optimize.search.search_state import of_rows
from studies.layout_search.first_layouts import limits_of
from studies.layout_search.target import LoadedTarget
from studies.layouts.refinement import kept_fewer
from studies.layouts.result import StudyResult

VERSIONS = f"fabdesign {__version__}, simulator {SIMULATOR}"
_MADE_AGAIN = ("study", "design", "pressures", "targets", "history", "fewer")
_KEPT = [field.name for field in fields(StudyResult) if field.name not in _MADE_AGAIN]  # as they are
_RAISED = ("limits.seconds", "limits.evaluations")  # without another result up to there
_NO_MATTER = ("name", "targets", "outputs")  # the targets' points count, not their files
_ABSENT = ("limits.contraction", "limits.channels", "limits.air")  # where there is no such limit


def study_content(study: Study, targets: Sequence[LoadedTarget]) -> dict[str, str]:
    """Return field (`limits.spacing`, `design.fabric.thickness`, `target.points`) to value, as text; pressures in
    kPa."""
    more: dict[str, Any] = {"limits.pressure": [in_kpa(pressure) for pressure in study.limits.pressure]}
    if study.start_pressures is not None:
        more["start_pressures"] = in_kpa(study.start_pressures).tolist()
    for number, target in enumerate(targets, start=1):
        name = "target" if len(targets) == 1 else f"target {number}"
        more[f"{name}.time"] = target.time
        more[f"{name}.weight"] = target.weight
        more[f"{name}.points"] = target.sha256
        if target.markers:
            more[f"{name}.distances"] = "from markers, one way"
        if target.landmarks is not None:
            more[f"{name}.wishes"] = target.landmarks.key
        if target.free:
            more[f"{name}.free"] = True
        if target.weighting is not None:
            more[f"{name}.regions"] = repr(target.weighting.regions)
        if target.face != "both":
            more[f"{name}.face"] = target.face
    content = content_of(study, _NO_MATTER, more)
    absent = {name for name in _ABSENT if content.get(name) == "None"}
    return {name: value for name, value in content.items() if name not in (*_RAISED, *absent)}


def keep(history: History, result: StudyResult, *, follow: bool) -> None:
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
        "follow": follow,
        "layout": {"muscles": result.design.muscles, "pressures": result.pressures.tolist()},
    }
    history.keep_answer(as_json(kept | {name: getattr(result, name) for name in _KEPT}))


def answer(history: History, study: Study, targets: Sequence[LoadedTarget], *, follow: bool) -> StudyResult | None:
    """Return the result that is kept, where a search within the study's limits would end with it; None where it may
    not."""
    kept, limits, kinds = history.answer(), study.limits, get_type_hints(StudyResult)
    try:
        as_far = kept["seconds"] >= limits.seconds and kept["evaluations"] >= limits.evaluations
        if kept["versions"] != VERSIONS or kept["follow"] != follow or not (kept["complete"] or as_far):
            return None
        [(space, _)] = of_rows([kept["layout"]], study.design, limits_of(study))
        values = {name: of_json(kinds[name], kept[name]) for name in _KEPT}
    except (KeyError, TypeError, ValueError, AttributeError):  # none, or of another version
        return None
    return StudyResult(
        study=study,
        design=space.design,
        pressures=space.start_pressures,
        targets=tuple(target.beside(shape) for target, shape in zip(targets, values["points"], strict=True)),
        history=tuple(history.entries()),
        **values,
        fewer=kept_fewer(study, history.load()),
    )
