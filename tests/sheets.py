"""A sheet rolled into an arc: two faces of points whose true surface is known."""

import numpy as np


def rolled_sheet(curvature=0.0, *, n=41, size=0.2, thickness=0.002):
    """(2 n n, 3) m, front face then back face, in the simulator's order; curvature in 1/m about the x axis."""
    v = np.linspace(0, size, n)
    angle = curvature * v
    sine, cosine = np.sin(angle), np.cos(angle)
    y, z = (-v, 0 * v) if curvature == 0 else (-sine / curvature, (1 - cosine) / curvature)
    sheet = np.empty((2, n, n, 3))
    sheet[..., 0] = v - size / 2
    for face, side in zip(sheet, (1, -1), strict=True):
        face[..., 1] = (y + side * thickness / 2 * sine)[:, None]
        face[..., 2] = (z + side * thickness / 2 * cosine)[:, None]
    return sheet.reshape(-1, 3)
