"""Searches for a layout and its pressures, and their reports (docs/search.md)."""
