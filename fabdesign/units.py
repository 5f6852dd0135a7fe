"""Units at the border. The code computes in SI; people and files get millimetres and kilopascals. The factors stand
here and nowhere else."""

from typing import Any, TypeVar

from numpy.typing import NDArray

Number = TypeVar("Number", float, NDArray[Any])


def in_mm(metres: Number) -> Number:
    """Millimetres of metres."""
    return 1e3 * metres


def from_mm(millimetres: Number) -> Number:
    """Metres of millimetres."""
    return 1e-3 * millimetres


def in_kpa(pascals: Number) -> Number:
    """Kilopascals of pascals."""
    return pascals / 1e3


def from_kpa(kilopascals: Number) -> Number:
    """Pascals of kilopascals."""
    return 1e3 * kilopascals
