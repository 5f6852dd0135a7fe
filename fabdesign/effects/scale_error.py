"""Scale error: all lengths that the cameras give are wrong by one factor."""

from typing import Any

from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values


def _observed(points: NDArray[Any], values: Values) -> NDArray[Any]:
    return points * (1.0 + values["scale"])


SCALE_ERROR = Effect(
    "scale_error",
    site="sensing",
    scope="sensors",
    what="coordinates are too large by `scale`, from the origin at the middle of the hung edge",
    signature="grows with the distance from the origin, at zero pressure too, in every trial alike",
    looks_like="a cloth cut larger than its data sheet says, or stretched in its frame; measure a gauge of known "
    "length in the same view",
    source="similarity transform of a calibration; docs/effects.md",
    parameters={"scale": EffectParameter("1", "error", 0.02, (-0.5, 0.5), 0.02, off=0.0)},
    observed=_observed,
)
