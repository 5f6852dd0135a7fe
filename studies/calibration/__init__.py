"""Declared parameters from measured clouds (docs/calibration.md)."""
