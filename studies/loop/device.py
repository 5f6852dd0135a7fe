"""How far the device is from the target: the measured shapes, compared as the search compares its own."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.metrics import Errors
from fabdesign.trial import MeasurementSet
from studies.layouts.target import LoadedTarget, target_errors
from studies.loop.resting_shape import resting_faces

Array = NDArray[np.float64]
AT_REST = 0.5  # s, the last of a trial in which a cloth counts as at rest


def measured_shapes(measured: MeasurementSet, targets: Sequence[LoadedTarget], believed: Array, *, seed: int) -> Array:
    """(poses, 2 n, 3) m: the cloth's faces in the trials of orders 0, 1, ..., one a target: at rest in the last half
    second, or in the frame at the target's time. believed: (poses, 2 n, 3) m, as the search had them."""
    by_order = {trial.order: trial for trial in measured.trials}
    shapes = []
    for pose, target in enumerate(targets):
        trial = by_order[pose]
        data = trial.load()
        if target.time is None:
            chosen = np.flatnonzero(data.time > data.time[-1] - AT_REST)
        else:
            chosen = np.array([np.abs(data.time - target.time).argmin()])
        points = np.concatenate([data.frames[int(k)] for k in chosen])
        shapes.append(resting_faces(points, trial.design.fabric, believed[pose], seed=seed))
    return np.array(shapes)


def device_errors(targets: Sequence[LoadedTarget], shapes: Array, measured: MeasurementSet, *, seed: int) -> Errors:
    """Of the measured shapes (poses, 2 n, 3) m against the targets: the same measures, with the same floors, as of the
    shapes that the search believed. Raises InputError where no shape was found."""
    if not np.isfinite(shapes).all():
        raise InputError(f"{measured.name}: no cloth lies through its points; expected measured clouds of one")
    return target_errors(targets, shapes, measured.trials[0].design, seed=seed)
