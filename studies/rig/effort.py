"""What a trial on the rig takes, estimated before it is begun."""

from collections.abc import Sequence

from fabdesign.effort import MEMORY
from fabdesign.errors import InputError
from studies.rig.scene import Resolution, control_counts
from studies.rig.specimen import TrialTask

_STEP = 48  # bytes of a control point and a step: position and velocity
_CONTROL = 360  # bytes of a control point and another in reach: the matrix, its factor and what they are made from
_FRAME, _POINT = 48, 120  # bytes of a frame: of each control point, and of each measured one


def trial_bytes(task: TrialTask, resolution: Resolution) -> float:
    """At the peak of a trial."""
    blocks, within, reach = control_counts(task.design, resolution)
    controls, frames = blocks * within, len(task.times)
    steps = float(task.times[-1]) / resolution.step
    kept = frames * (_FRAME * controls + _POINT * task.key.sensing.points)
    return steps * controls * _STEP + controls * within * reach * _CONTROL + kept


def require_room(tasks: Sequence[TrialTask], resolution: Resolution) -> int:
    """How many of the trials fit into memory at once. Raises InputError where one alone does not."""
    most = 0.0
    for task in tasks:
        needed = trial_bytes(task, resolution)
        if needed > MEMORY:
            cloth = task.design.fabric
            raise InputError(
                f"program {task.order}: {task.times[-1]:g} s of a cloth of {cloth.width:g} by {cloth.height:g} m, "
                f"{len(task.times)} frames of {task.key.sensing.points} points, take {needed / 1e9:.2g} GB on the rig; "
                f"expected at most {MEMORY / 1e9:g} GB"
            )
        most = max(most, needed)
    return max(1, int(2 * MEMORY / most))
