"""What makes a study the same study: all that its search depends on, by field."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from fabdesign.study_file import Study
from fabdesign.units import in_kpa
from studies.layouts.target import LoadedTarget

_RAISED = ("limits.seconds", "limits.evaluations")  # without another result up to there
_NO_MATTER = ("name", "targets", "outputs")  # the targets' points count, not their files
_ABSENT = ("limits.contraction", "limits.channels", "limits.air")  # where there is no such limit
_LONGEST = 200  # characters that are kept of a value; of longer ones their hash


def study_content(study: Study, targets: Sequence[LoadedTarget]) -> dict[str, str]:
    """Field (`limits.spacing`, `design.fabric.thickness`, `target.points`) to value, as text; pressures in kPa."""
    content: dict[str, Any] = {}
    for field in fields(study):
        if field.name not in _NO_MATTER:
            content |= flat(getattr(study, field.name), field.name)
    content = {name: value for name, value in content.items() if name not in _ABSENT or value is not None}
    content["limits.pressure"] = [in_kpa(pressure) for pressure in study.limits.pressure]
    if study.start_pressures is not None:
        content["start_pressures"] = in_kpa(study.start_pressures).tolist()
    for number, target in enumerate(targets, start=1):
        name = "target" if len(targets) == 1 else f"target {number}"
        content[f"{name}.time"] = target.time
        content[f"{name}.weight"] = target.weight
        content[f"{name}.points"] = hashlib.sha256(target.points.tobytes()).hexdigest()
        if target.markers:
            content[f"{name}.distances"] = "from markers, one way"
        if target.landmarks is not None:
            content[f"{name}.wishes"] = target.landmarks.key
        if target.free:
            content[f"{name}.free"] = True
        if target.weighting is not None:
            content[f"{name}.regions"] = repr(target.weighting.regions)
        if target.face != "both":
            content[f"{name}.face"] = target.face
    return {name: shortened(str(value)) for name, value in content.items() if name not in _RAISED}


def flat(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """A value's parts by field, down to what is no dataclass."""
    if is_dataclass(value):
        for field in fields(value):
            yield from flat(getattr(value, field.name), f"{name}.{field.name}")
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            yield from flat(entry, f"{name}.{key}")
    elif isinstance(value, tuple) and any(map(is_dataclass, value)):
        for number, entry in enumerate(value, start=1):
            yield from flat(entry, f"{name} {number}")
    else:
        yield name, value.tolist() if isinstance(value, np.ndarray) else value


def shortened(text: str) -> str:
    """The text, or of a long one its hash."""
    return text if len(text) <= _LONGEST else "sha256 " + hashlib.sha256(text.encode()).hexdigest()
