"""Specimens on a bench: laws of muscles, strips, cylinders and actuators, fitted to records and evaluated. Belongs
here: a law that needs no cloth."""

from studies.benches.records import SIZES, require_columns, require_sizes

__all__ = ["SIZES", "require_columns", "require_sizes"]
