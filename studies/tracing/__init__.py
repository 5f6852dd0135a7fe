"""This package finds which declared effect explains the residual that a model's parameters leave (docs/trace.md).
Model selection and its report belong here; the fits are `optimize.fit`."""

from studies.tracing.report import verdict_in_words
from studies.tracing.run import Options, trace_set

__all__ = ["Options", "trace_set", "verdict_in_words"]
