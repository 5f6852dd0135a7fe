"""The kinds of files that dataclasses declare: `fabdesign schema` and the tables of keys in the docs come from them."""

from collections.abc import Mapping
from typing import Any

from fabdesign.bench_file import BenchKeys
from fabdesign.bench_law_file import LawKeys
from fabdesign.design import Design
from fabdesign.design_file import DesignHead, DesignScene
from fabdesign.errors import InputError
from fabdesign.json_schema import json_schema
from fabdesign.layouts_file import LayoutsStudy
from fabdesign.loop_file import LoopStudy
from fabdesign.model import Model
from fabdesign.recording import RecordingKeys
from fabdesign.sensitivity_file import SensitivityStudy
from fabdesign.study_file import Study, StudyHead
from fabdesign.table import nearest
from fabdesign.trial import MeasurementSet
from fabdesign.unseen_file import UnseenStudy
from studies.rig.ground_truth import GroundTruth

STUDIES: Mapping[str, type] = {
    "optimize": Study,
    "sensitivity": SensitivityStudy,
    "layouts": LayoutsStudy,
    "unseen": UnseenStudy,
    "loop": LoopStudy,
}
KINDS: Mapping[str, tuple[type, ...]] = {
    "design": (DesignHead, DesignScene, Design),
    "model": (Model,),
    "study": (StudyHead,),  # with those of one of STUDIES
    "measurement-set": (MeasurementSet,),
    "recording": (RecordingKeys,),
    "bench": (BenchKeys,),
    "bench-law": (LawKeys,),
    "key": (GroundTruth,),
}


def schema_of(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of one of KINDS. Raises InputError for any other."""
    if kind not in KINDS:
        raise InputError(f"schema {kind}: expected one of {', '.join(KINDS)}{nearest(kind, [*KINDS])}")
    if kind == "study":
        studies = [_study(name, form) for name, form in STUDIES.items()]
        return {"$schema": studies[0].pop("$schema"), "title": studies[0]["title"], "oneOf": studies}
    schema = json_schema(kind, KINDS[kind])
    if kind == "design":  # a file that others include has some of its keys
        del schema["properties"]["fabric"]["required"]
        schema["required"] = []
    return schema


def _study(name: str, form: type) -> dict[str, Any]:
    schema = json_schema("study", (StudyHead, form), format_line=False)
    schema["properties"]["kind"] = {"const": name}
    return schema
