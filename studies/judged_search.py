"""Former names of `studies.sensitive_stretches`, for `studies.calibration` and `studies.tracing`, as in `judged`."""

from studies.sensitive_stretches import GRID
from studies.sensitive_stretches import find_used_frames as judge_sets
from studies.sensitive_stretches import sensitive_stretches as unjudged

__all__ = ["GRID", "judge_sets", "unjudged"]
