"""Declared parameters from measured clouds (docs/calibration.md). Belongs here: what puts a measured set and a model
file around a fit; the fit itself is `optimize.fit`."""
