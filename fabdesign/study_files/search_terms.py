"""Tables of a study that say what a search weighs besides the distance: `[price]` and `[robust]`."""

from dataclasses import dataclass
from typing import Annotated, Literal

from fabdesign.formats.schema import ABOVE_0, FROM_0, SHARE, Metre, Millimetre, Within


@dataclass(frozen=True)
class Price:
    """The gain that muscles must bring to a layout whose number may vary."""

    muscle: Annotated[Millimetre, FROM_0, "of the objective that one more muscle must gain"] = 0.0  # m
    channel: Annotated[Millimetre, FROM_0, "of the objective that one more pressure channel must gain"] = 0.0  # m
    tolerance: Annotated[float, SHARE, "of the objective, by which fewer muscles may be worse in any case"] = 0.03

    def allowed(self, value: float, fewer: int) -> float:
        """Return the error [m] that is allowed to a layout with `fewer` muscles, each with its channel, less than one
        that reaches `value` m."""
        return max((1 + self.tolerance) * value, value + fewer * (self.muscle + self.channel))


NO_PRICE = Price()


@dataclass(frozen=True)
class Robust:
    """Scatter of what is built, as standard deviations, and what the result is chosen for."""

    placement: Annotated[Metre, Within(above=0, most=0.1), "of every corner point of a muscle, in u and in v"] = 0.002
    pressure: Annotated[float, Within(least=0, most=0.5), "of every channel, relative"] = 0.05
    muscle_gain: Annotated[float, Within(least=0, most=0.5), "of every muscle, relative"] = 0.04
    covariance: Annotated[bool, "the model's joint covariance scatters too, where it has one"] = True
    copies: Annotated[int, Within(least=8, most=1000), "of the result, true ones"] = 24
    tolerance: Annotated[Millimetre | None, ABOVE_0, "of a copy that counts; absent: 1.25 times the result"] = None  # m
    choose: Annotated[Literal["expected", "yield"], "for what the result is chosen"] = "expected"
