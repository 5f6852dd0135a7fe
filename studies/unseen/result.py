"""The content of `result.json` of a study of what is not measured yet: mm, kPa, 1/m."""

from typing import Any, NotRequired, TypedDict

Percentiles = list[float]  # 5, 50 and 95 % over the drawn models


class OutputPercentiles(TypedDict):
    """The percentiles of an output that the study asks for."""

    unit: str
    percentiles: Percentiles


class PoseResult(TypedDict):
    """Shapes at rest under one row of pressures. band: RMS that a drawn model's shape lies from the mean shape; widest:
    where that is most. snaps: near a bifurcation. middle: m, each model's z and y down the middle line, for the picture
    alone. failed: models that found no shape at rest."""

    pressures_kpa: list[float]
    band_mm: float
    widest_mm: float
    tip_mm: dict[str, Percentiles]
    outputs: dict[str, OutputPercentiles]
    mean_curvature: Percentiles
    failed: int
    snaps: bool
    middle: NotRequired[list[list[list[float]]]]


class ProposedProgram(TypedDict):
    """Set points of a pressure program."""

    time_s: list[float]
    pressure_kpa: list[list[float]]
    duration_s: float


class CandidateResult(TypedDict):
    """left: spread of the shapes after this measurement."""

    design: str
    left_mm: float


class Measurement(TypedDict):
    """The information of a measurement. due_to: spread by each unknown's own part, in the covariance's order;
    candidates: the best first, and its program. in_turn: those that tell most together, each beside those before it,
    and the spread that they leave."""

    spread_mm: float
    due_to_mm: dict[str, float]
    candidates: dict[str, CandidateResult]
    program: ProposedProgram | None
    in_turn_mm: dict[str, float]


class CorrectorStatement(TypedDict):
    """applies: None where the model has no corrector."""

    applies: bool | None
    said: str
    distance: NotRequired[float]
    limit: NotRequired[float]


class UnseenResult(TypedDict):
    """design to measurement: of a layout before it is sewn. free and left_out: of designs left out in turn. None: not
    begun, because the time was used. calibrated: whether the shapes' intervals are; intervals: what they are from, in
    words."""

    name: str
    seed: int
    points_per_side: int
    design: NotRequired[str]
    model_points_per_side: NotRequired[int]
    doubted: NotRequired[list[str]]
    poses: NotRequired[list[PoseResult] | None]
    unknown: NotRequired[list[str]]
    calibrated: NotRequired[bool]
    intervals: NotRequired[str]
    corrector: NotRequired[CorrectorStatement]
    measurement: NotRequired[Measurement | None]
    free: NotRequired[list[str]]
    left_out: NotRequired[dict[str, dict[str, Any] | None]]
    wall_s: NotRequired[float]
