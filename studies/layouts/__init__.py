"""Searches for a layout and its pressures, and their reports (docs/layout_search.md). Belongs here: what a study file
of kind "optimize" asks for, around the search in `optimize`."""
