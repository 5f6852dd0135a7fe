"""Declared parameters from measured clouds (docs/calibration.md). Belongs here: what puts a measured set and a model
file around a fit; the fit itself is `optimize.fit`."""

from studies.calibration.calibrate import CalibrationOptions, calibrate_sets
from studies.calibration.result import Calibration

__all__ = ["Calibration", "CalibrationOptions", "calibrate_sets"]
