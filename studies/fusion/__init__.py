"""Depth sensors' clouds become a measurement set."""
