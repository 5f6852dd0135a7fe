"""From a network's outputs to a displacement: what each of them means, and their symmetries."""

import numpy as np
from numpy.typing import NDArray

from corrector.shape import FINE, Floats, Frames, put_together, refine, tangent_changes
from fabdesign.fabric import Fabric

# at a node: curvature uu, vv, uv that the cloth would like to have on top of its own; strain u, v; turn in the plane
LOCAL_SCALE = np.array([1.0, 1.0, 1.0, 0.01, 0.01, 0.01], dtype=np.float32)  # 1/m, 1/m, 1/m, 1, 1, rad
# of the whole cloth: a swing about the top edge, and one whose two sides go opposite ways; statics know none
SWING_SCALE = np.array([0.05, 0.05], dtype=np.float32)  # rad
LOCAL, SWINGS = len(LOCAL_SCALE), len(SWING_SCALE)
LOCAL_U = np.array([1, 1, -1, 1, 1, -1], dtype=np.float32)  # signs when the cloth is mirrored left to right
LOCAL_Z = np.array([-1, -1, -1, 1, 1, 1], dtype=np.float32)  # and when its faces are exchanged
SWINGS_U = np.array([1, -1], dtype=np.float32)
SWINGS_Z = np.array([-1, -1], dtype=np.float32)
TURNED = np.array([1, 0, 2, 4, 3, 5])  # order when u is taken for v
TURNED_SIGNS = np.array([1, 1, 1, 1, 1, -1], dtype=np.float32)


def displacement_of(
    local: Floats, swings: Floats, frames: Frames, fabric: Fabric, slopes: NDArray[np.float64]
) -> NDArray[np.float32]:
    """(B, FINE, FINE, 3) m of the mid-surface, from outputs (B, LOCAL, n, n) and (B, SWINGS).

    frames: of the simulated cloth, at FINE x FINE nodes. slopes: `response.slopes` at as many.
    """
    fine = refine(np.moveaxis(local, 1, -1), FINE)
    curvature = np.moveaxis(fine[..., :3], -1, 1).reshape(len(local), -1)
    tilts = (curvature @ slopes.T.astype(np.float32)).reshape(-1, 2, FINE, FINE)
    across = np.linspace(-1, 1, FINE, dtype=np.float32)
    tilts[:, 1] += swings[:, 0, None, None] + swings[:, 1, None, None] * across
    changes = tangent_changes(np.moveaxis(tilts, 1, -1), fine[..., 3:], frames)
    return put_together(*changes, fabric).astype(np.float32)
