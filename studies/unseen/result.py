"""The result of a study of what is not measured yet: `result.json` in mm, kPa and 1/m."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from fabdesign.formats.result_tables import Columns, Tabled, by_name
from fabdesign.formats.schema import Key

Percentiles = list[float]  # 5, 50 and 95 % over the drawn models


@dataclass(frozen=True)
class OutputSpread:
    """The values of an output that the study asks for."""

    unit: str
    percentiles: Percentiles


@dataclass(frozen=True)
class PoseResult:
    """Shapes at rest under one row of pressures. band: RMS that a drawn model's shape lies from the mean shape; widest:
    where that is most. snaps: near a bifurcation. middle: m, each model's z and y down the middle line, for the picture
    alone. failed: models that found no shape at rest. outputs: by what the study asks for."""

    pressures_kpa: list[float]
    band_mm: float
    widest_mm: float
    tip_mm: dict[str, Percentiles]
    outputs: dict[str, OutputSpread]
    mean_curvature: Percentiles
    failed: int
    snaps: bool
    middle: Annotated[list[list[list[float]]], Key("")]


@dataclass(frozen=True)
class RankedMeasurement:
    """A measurement on a design, and the spread that it would leave."""

    design: str
    remaining_mm: Annotated[float, Key("left_mm")]


@dataclass(frozen=True)
class SetPoints:
    """A program, a row of pressures a time."""

    time_s: list[float]
    pressure_kpa: list[list[float]]
    duration_s: float


@dataclass(frozen=True)
class Measurement:
    """The information of a measurement. due_to: spread by each unknown's own part, in the covariance's order;
    candidates: the best first, and its program. in_turn: those that tell most together, each beside those before it,
    and the spread that they leave."""

    spread_mm: float
    due_to_mm: dict[str, float]
    candidates: dict[str, RankedMeasurement]
    program: SetPoints | None
    in_turn_mm: dict[str, float]


@dataclass(frozen=True)
class CorrectorReach:
    """Whether the model's corrector applies to the design, and in words; None: the model has none."""

    applies: bool | None
    sentence: str
    distance: Annotated[float | None, Key(brief=True)] = None
    limit: Annotated[float | None, Key(brief=True)] = None
    json_keys: ClassVar = "applies", "distance", "limit", ("said", "sentence")


@dataclass(frozen=True)
class UnsewnResult:
    """A layout before it is sewn. calibrated: whether the shapes' intervals are; intervals: what they are from, in
    words. None: not begun, because the time was used."""

    design: str
    model_points_per_side: int
    doubted: Sequence[str]
    poses: list[PoseResult] | None
    unknown: Sequence[str]
    calibrated: bool
    intervals: str
    corrector: CorrectorReach
    measurement: Measurement | None


@dataclass(frozen=True)
class UnseenResult(Tabled):
    """free and left_out: of designs left out in turn; None of one that was not begun, because the time was used."""

    name: str
    seed: int
    points_per_side: int
    unsewn: Annotated[UnsewnResult | None, Key(inside=True)] = None
    free: Annotated[Sequence[str] | None, Key(brief=True)] = None
    left_out: Annotated[dict[str, dict[str, Any] | None] | None, Key(brief=True)] = None
    wall_s: float = 0.0

    def columns(self) -> Columns:
        """Return a row a pose and output: pose, output, unit, and its 5, 50 and 95 % over the drawn models."""
        rows: list[dict[str, object]] = []
        for number, pose in enumerate((self.unsewn and self.unsewn.poses) or ()):
            values = [(f"tip_{axis}", "mm", ends) for axis, ends in pose.tip_mm.items()]
            values.append(("mean_curvature", "1/m", pose.mean_curvature))
            values += [(name, output.unit, output.percentiles) for name, output in pose.outputs.items()]
            rows += [
                {"pose": number, "output": name, "unit": unit, "low90": low, "middle": middle, "high90": high}
                for name, unit, (low, middle, high) in values
            ]
        return by_name(rows)
