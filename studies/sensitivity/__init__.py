"""Sweeps: what a shape depends on, by Morris screening and Sobol indices."""
