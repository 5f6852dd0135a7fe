"""Sweeps: what a shape depends on, by Morris screening and Sobol indices (docs/sensitivity.md). Belongs here: samples,
estimators, their report."""
