"""Layouts drawn flat, and what a workshop sews from: templates as SVG, PDF and DXF, pages of a home printer."""
