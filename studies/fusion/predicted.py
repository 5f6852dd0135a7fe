"""The cloth as it is simulated, for cutting: what of an image lies near to it, at the image's own time."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from fabdesign.clouds.recording import Recording
from fabdesign.nouns.forward import Case

RATE = 60.0  # Hz
GRID = 21  # points a side of the simulator; its faces have more


def predicted_cloth(recording: Recording) -> Callable[[float], cKDTree]:
    """Return what gives the simulated cloth's points at a time [s after the pressure's 0], by the design as it is
    declared; before 0 and after the pressures' end as it was there."""
    from sim import Simulator

    program = recording.program
    times = np.arange(round(program.duration * RATE) + 1) / RATE
    case = Case(recording.design, program)
    points = Simulator(points_per_side=GRID).motions([case], [times])[0]

    @lru_cache(maxsize=16)
    def tree(index: int) -> cKDTree:
        return cKDTree(points[index])

    return lambda time: tree(int(np.clip(round(time * RATE), 0, len(times) - 1)))
