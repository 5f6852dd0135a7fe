"""Motions, measured clouds and predictions side by side: a page, a picture, an animation."""
