"""The kinds of files that dataclasses declare: `fabdesign schema` and the tables of keys in the docs come from them."""

from collections.abc import Mapping
from typing import Any

from fabdesign.clouds.recording import RecordingKeys
from fabdesign.errors import InputError
from fabdesign.files.bench_file import BenchKeys
from fabdesign.files.design_file import DesignHead, DesignScene
from fabdesign.files.law_tables import BenchLaw
from fabdesign.formats.schema import json_schema
from fabdesign.formats.table import nearest
from fabdesign.nouns.design import Design
from fabdesign.nouns.model import Model
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.study_files.follow_file import FollowStudy
from fabdesign.study_files.layouts_file import LayoutsStudy
from fabdesign.study_files.loop_file import LoopStudy
from fabdesign.study_files.sensitivity_file import SensitivityStudy
from fabdesign.study_files.study_file import Kind, Study, StudyFile, StudyHead
from fabdesign.study_files.unseen_file import UnseenStudy
from studies.rig import GroundTruth

STUDIES: Mapping[Kind, type[StudyFile]] = {
    "optimize": Study,
    "sensitivity": SensitivityStudy,
    "layouts": LayoutsStudy,
    "unseen": UnseenStudy,
    "loop": LoopStudy,
    "follow": FollowStudy,
}
KINDS: Mapping[str, tuple[type, ...]] = {
    "design": (DesignHead, DesignScene, Design),
    "model": (Model,),
    "study": (StudyHead,),  # with those of one of STUDIES
    "measurement-set": (MeasurementSet,),
    "recording": (RecordingKeys,),
    "bench": (BenchKeys,),
    "bench-law": (BenchLaw,),
    "key": (GroundTruth,),
}


def schema_of(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of one of KINDS. Raises InputError for any other."""
    if kind not in KINDS:
        raise InputError(f"schema {kind}: expected one of {', '.join(KINDS)}{nearest(kind, [*KINDS])}")
    if kind == "study":
        studies = [json_schema("study", (StudyHead, form), required=()) for form in STUDIES.values()]
        for name, study in zip(STUDIES, studies, strict=True):
            study["properties"]["kind"] = {"const": name}
        return {"$schema": studies[0].pop("$schema"), "title": studies[0]["title"], "oneOf": studies}
    schema = json_schema(kind, KINDS[kind])
    if kind == "design":  # a file that others include has some of its keys
        del schema["properties"]["fabric"]["required"]
        schema["required"] = []
    return schema
