"""Searches for a layout and its pressures, and their reports (docs/layout_search.md). Belongs here: what a study file
of kind "optimize" asks for, around the search in `optimize`."""

from studies.layouts.report import ERRORS, WISHED, error_cells, render_report, target_texts
from studies.layouts.result import VERSIONS, StudyResult, Verification, study_content
from studies.layouts.run import run_study

__all__ = [
    "ERRORS", "VERSIONS", "WISHED", "StudyResult", "Verification", "error_cells", "render_report",
    "run_study", "study_content", "target_texts",
]  # fmt: skip
