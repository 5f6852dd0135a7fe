"""A sheet rolled into an arc: two faces of points whose true surface is known."""

import numpy as np


def rolled_sheet(curvature=0.0, *, n=41, size=0.2, thickness=0.002):
    """(2 n n, 3) m, front face then back face, in the simulator's order; curvature in 1/m about the x axis."""
    u, v = np.meshgrid(np.linspace(0, size, n), np.linspace(0, size, n))
    angle = curvature * v
    y, z = (-v, 0 * v) if curvature == 0 else (-np.sin(angle) / curvature, (1 - np.cos(angle)) / curvature)
    middle = np.stack([u - size / 2, y, z], axis=-1)
    normal = np.stack([0 * u, np.sin(angle), np.cos(angle)], axis=-1)
    return np.concatenate([(middle + side * thickness / 2 * normal).reshape(-1, 3) for side in (1, -1)])
