"""What makes a study the same study: all that its search depends on, by field."""

from collections.abc import Sequence
from typing import Any

from fabdesign.content import content_of
from fabdesign.study_file import Study
from fabdesign.units import in_kpa
from studies.layouts.target import LoadedTarget

_RAISED = ("limits.seconds", "limits.evaluations")  # without another result up to there
_NO_MATTER = ("name", "targets", "outputs")  # the targets' points count, not their files
_ABSENT = ("limits.contraction", "limits.channels", "limits.air")  # where there is no such limit


def study_content(study: Study, targets: Sequence[LoadedTarget]) -> dict[str, str]:
    """Field (`limits.spacing`, `design.fabric.thickness`, `target.points`) to value, as text; pressures in kPa."""
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
