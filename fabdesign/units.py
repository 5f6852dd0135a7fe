"""Units at the border. The code computes in SI; people and files get millimetres and kilopascals. The factors stand
here and nowhere else."""

from decimal import Decimal
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:  # the help of a command needs no numpy, which takes a fifth of a second to load
    from typing import Any

    from numpy.typing import NDArray

Number = TypeVar("Number", float, "NDArray[Any]")


def in_mm(metres: Number) -> Number:
    """Return millimetres of metres."""
    return 1e3 * metres


def from_mm(millimetres: Number) -> Number:
    """Return metres of millimetres."""
    return 1e-3 * millimetres


def in_kpa(pascals: Number) -> Number:
    """Return kilopascals of pascals."""
    return pascals / 1e3


def from_kpa(kilopascals: Number) -> Number:
    """Return pascals of kilopascals."""
    return 1e3 * kilopascals


def pascals(kilopascals: Decimal | int | str) -> float:
    """Return Pa from a number in kPa, by shifting its decimal point: no rounding twice."""
    return float(Decimal(kilopascals).scaleb(3))


def kilopascals(pressure: float) -> Decimal:
    """Return kPa from Pa, exactly the digits that `pascals` turns back into the same float."""
    return Decimal(repr(float(pressure))).scaleb(-3)
