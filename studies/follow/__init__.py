"""Pressures over time for a target that moves. Belongs here: what is wanted when, the windows that are solved one after
another, what is measured fed back, and the report."""

from studies.follow.programs import Regulator, case_of, regulator_of
from studies.follow.wanted import Wanted, wanted_of

__all__ = ["Regulator", "Wanted", "case_of", "regulator_of", "wanted_of"]
