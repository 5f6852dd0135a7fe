"""What a model lacks: which declared effect takes the residual that its parameters leave (docs/trace.md). Belongs here:
model selection and its report; the fits are `optimize.fit`."""
