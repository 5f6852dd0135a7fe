"""Tables of a study that say what a search weighs besides the distance: `[price]` and `[robust]`."""

from dataclasses import dataclass
from typing import Literal

from fabdesign.table import Table
from fabdesign.units import from_mm


@dataclass(frozen=True)
class Price:
    """muscle, channel: m of the objective that one more must gain. tolerance: the share of the objective by which a
    layout of fewer muscles may be worse in any case."""

    muscle: float = 0.0
    channel: float = 0.0
    tolerance: float = 0.03

    def allowed(self, value: float, fewer: int) -> float:
        """m, for a layout with `fewer` muscles, each with its channel, less than one that reaches `value` m."""
        return max((1 + self.tolerance) * value, value + fewer * (self.muscle + self.channel))


@dataclass(frozen=True)
class Robust:
    """Scatter of what is built, as standard deviations, and what the result is chosen for.

    placement: m, of every corner point of a muscle, in u and in v. pressure: relative, of every channel. muscle_gain:
    relative, of every muscle. covariance: whether the model's joint covariance scatters too. tolerance: m of the
    objective within which a copy counts for the yield; None: a quarter over the nominal value.
    """

    placement: float = 0.002
    pressure: float = 0.05
    muscle_gain: float = 0.04
    covariance: bool = True
    copies: int = 24
    tolerance: float | None = None
    choose: Literal["expected", "yield"] = "expected"


def read_price(root: Table) -> Price:
    """Keys: docs/files.md. Raises InputError."""
    table = root.table("price", None)
    if table is None:
        return Price()
    price = Price(
        muscle=from_mm(table.number("muscle", 0.0, least=0)),
        channel=from_mm(table.number("channel", 0.0, least=0)),
        tolerance=table.number("tolerance", Price().tolerance, least=0, most=1),
    )
    table.finish()
    return price


def read_robust(root: Table) -> Robust | None:
    """None where the study has no such table. Keys: docs/files.md. Raises InputError."""
    table = root.table("robust", None)
    if table is None:
        return None
    default = Robust()
    tolerance = from_mm(table.number("tolerance", above=0)) if "tolerance" in table else None
    robust = Robust(
        placement=table.number("placement", default.placement, above=0, most=0.1),
        pressure=table.number("pressure", default.pressure, least=0, most=0.5),
        muscle_gain=table.number("muscle_gain", default.muscle_gain, least=0, most=0.5),
        covariance=table.flag("covariance", default.covariance),
        copies=table.integer("copies", default.copies, least=8, most=1000),
        tolerance=tolerance,
        choose=table.text("choose", default.choose, choices=("expected", "yield")),
    )
    table.finish()
    return robust
