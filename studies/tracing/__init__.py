"""This package finds which declared effect explains the residual that a model's parameters leave (docs/trace.md).
Model selection and its report belong here; the fits are `optimize.fit`."""
