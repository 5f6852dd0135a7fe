"""How a few markers on the cloth lie in the world: they need not show its edge, so that one-way distances decide.

What a file says of its own origin is worth more than what so few points show of the hung edge: of the 24 ways to
exchange axes, one about the file's own origin is taken where it brings the markers about as near to the hanging cloth
as any. Only then is their uppermost laid below the hung edge.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fabdesign.fabric import Fabric
from fabdesign.hung_cloth import misplaced
from fabdesign.placement import CLEAR, OVER, SAME, TIE, PlacementFit, differ, placement_of, right_angles

Array = NDArray[np.float64]

MARKERS = 200  # points; a cloud of fewer is markers: what lies between them is not measured
_OWN = 0.25  # of the markers' spacing, that another origin must gain over the file's own
_UPPER = 0.25  # of the markers, that show how deep the edge lies


def fit_markers(
    points: Array, fabric: Fabric, *, factor: float = 1.0, rotation: tuple[float, float, float] | None = None
) -> PlacementFit:
    """The placement of points (n, 3), in the file's unit, by the mean distance from them to the hanging cloth.

    rotation: degrees, where it is known; else the 24 ways to exchange axes are tried, the least turn first.
    """
    given = Rotation.from_euler("xyz", rotation or np.zeros(3), degrees=True)
    metres = given.apply(factor * points)
    own, laid = [], []
    for turn in right_angles()[: 1 if rotation is not None else None]:
        turned = turn.apply(metres)
        tie = TIE * float(turn.magnitude()) / (np.pi / 2)
        if misplaced(turned, fabric) is None:
            own.append((_gap(turned, fabric) + tie, turn * given, np.zeros(3)))
        shift = _below_the_edge(turned, fabric)
        laid.append((_gap(turned + shift, fabric) + tie, turn * given, shift))
    spacing = float(np.sqrt(fabric.width * fabric.height / len(points)))
    best = min(gap for gap, _, _ in laid)
    sound = [candidate for candidate in own if candidate[0] <= best + _OWN * spacing] or laid
    least, turn, shift = min(sound, key=lambda candidate: candidate[0])
    near = [(gap, other, placement_of(factor, other, s)) for gap, other, s in sound if gap < least + CLEAR]
    over = [p for _, other, p in near if differ(other, OVER * turn) < SAME]
    rivals = [p for _, other, p in near if min(differ(other, turn), differ(other, OVER * turn)) >= SAME]
    return PlacementFit(placement_of(factor, turn, shift), over[0] if over else None, rivals[0] if rivals else None)


def _below_the_edge(points: Array, fabric: Fabric) -> Array:
    """The shift that lays the markers' middle below the edge's, the uppermost as far below it as spread evenly."""
    upper = points[points[:, 1] >= np.quantile(points[:, 1], 1 - _UPPER)]
    across = (points[:, 0].min() + points[:, 0].max()) / 2
    return -np.array([across, points[:, 1].max() + fabric.height / (len(points) + 1), np.median(upper[:, 2])])


def _gap(points: Array, fabric: Fabric) -> float:
    """m: mean distance from the markers to the cloth as it hangs without pressure, flat."""
    half = fabric.width / 2
    x, y = points[:, 0].clip(-half, half), points[:, 1].clip(-fabric.height, 0)
    return float(np.linalg.norm(points - np.stack([x, y, 0 * x], axis=1), axis=1).mean())
