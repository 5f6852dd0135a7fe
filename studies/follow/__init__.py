"""Pressures over time for a target that moves. Belongs here: what is wanted when, the windows that are solved one after
another, what is measured fed back, and the report."""
