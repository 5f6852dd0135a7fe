"""What a model's intervals do to the lower edge: a band of 90 % around its profile, to first order."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.mid_surface import mid_surface
from fabdesign.model import Model
from fabdesign.model_sampling import drawn, joint_root

NORMAL90 = 1.6449  # standard deviations to either side that hold 90 % of a normal distribution
Array = NDArray[np.float64]


def lower_edge(points: NDArray[np.float32]) -> Array:
    """(n, 3) m, the mid-surface's last row, of a shape (2 n^2, 3) m."""
    return np.asarray(mid_surface(points)[-1], dtype=np.float64)


def models_around(model: Model) -> list[Model]:
    """Two for each column of the covariance's root, one standard deviation to either side, without the corrector; none
    where the model has no joint covariance."""
    try:
        root = joint_root(model)
    except InputError:
        return []
    plain = model.without(["corrector"])
    return [drawn(plain, root, sign * unit) for unit in np.eye(len(root)) for sign in (1.0, -1.0)]


@dataclass(frozen=True, eq=False)
class Band:
    """half: (n, 3) m, to either side of the lower edge, in x, y and z."""

    half: Array

    @staticmethod
    def of(shapes: list[NDArray[np.float32]]) -> "Band":
        """Of the shapes under `models_around`, in their order: half the difference of two is a column of deviations,
        and deviations of independent columns add up squared."""
        edges = np.array([lower_edge(shape) for shape in shapes]).reshape(-1, 2, len(lower_edge(shapes[0])), 3)
        columns = (edges[:, 0] - edges[:, 1]) / 2
        return Band(NORMAL90 * np.sqrt(np.square(columns).sum(axis=0)))
