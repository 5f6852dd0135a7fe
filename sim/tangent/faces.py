"""From a mid-surface and its changes to the two faces and theirs."""

import numpy as np

from fabdesign.nouns.jacobian import FacesJacobian
from sim.motion import faces
from sim.tangent.differences import Jacobian

FAR = 1e-5  # m that a node is moved at most: normals turn by 1e-3 on grids of 5 mm, and the rest is of second order


def faces_changes(jacobian: Jacobian, thickness: float) -> FacesJacobian:
    """Of one shape, (n, n, 3) m: central differences of the faces in float64."""
    middle, changes = jacobian.middle.astype(float), jacobian.changes.astype(float)
    [points] = faces(middle[None], thickness)
    largest = np.abs(changes).max(axis=(1, 2, 3), initial=0.0)
    by = FAR / np.where(largest > 0, largest, 1.0)[:, None, None, None]
    ahead, behind = (faces(middle + sign * by * changes, thickness) for sign in (1, -1))
    return FacesJacobian(points, (ahead - behind) / (2 * by[:, 0]), jacobian.exact)
