"""A more robust layout from one that was found: its places and pressures moved for the mean of copies, and single
muscles laid as two beside each other, whose errors are independent and average out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fabdesign.nouns.predictor import Predictor
from fabdesign.study_files.study_file import Study
from fabdesign.study_files.study_targets import Robust
from optimize.search.objective import Objective
from optimize.search.starts import Start
from optimize.search.variations import doubled
from studies.layouts.robust_descent import Copies, descend
from studies.layouts.robustness import normals
from studies.layouts.scatter import Scatter

JUDGED = 64  # copies by which layouts are compared, others than those that the descent takes
SHARES = (0.5, 0.6, 0.7, 0.8)  # of a muscle's pressure, in each of two: their pull is no straight line in it
TRIED = 4  # doubled layouts, nearest first, of which copies are simulated
GAIN = 0.02  # of the expected value,
YIELD_GAIN = 0.05  # and of the copies, that a change must gain
ENOUGH = 0.97  # of the copies within the tolerance
PATIENCE = 2  # doubled muscles in a row without a gain

Going = Callable[[], bool]


@dataclass(frozen=True, eq=False)
class MoreRobust:
    """start: the layout found. expected: m, and yielded: share within the tolerance, of copies on the coarse model.
    doubled: how many times a muscle was laid as two."""

    start: Start
    expected: float
    yielded: float
    doubled: int = 0

    @property
    def muscles(self) -> int:
        return len(self.start[0].design.muscles)

    def gains_on(self, other: "MoreRobust", robust: Robust, price: float) -> bool:
        """Return whether it is worth the change; price: m of the objective that each further muscle must gain."""
        gained = other.expected - self.expected
        if not gained >= max(0, self.muscles - other.muscles) * price:
            return False
        if robust.choose == "yield":
            return self.yielded >= other.yielded + YIELD_GAIN
        return gained >= GAIN * other.expected


def more_robust(
    study: Study,
    robust: Robust,
    start: Start,
    objective: Objective,
    forward: Predictor,
    *,
    tolerance: float,
    going: Going = lambda: True,
) -> MoreRobust:
    """Return a more robust layout, by `forward`, the coarse model. Muscles are doubled where the study lets their
    number vary, up to its most, and while that gains. tolerance: m. going: asked before every round; what it cuts is no
    worse than `start`. Of targets that are frames of a motion too early to be near rest it is `start` itself."""
    objective = objective.at_rest
    if any(target.time is not None for target in objective.targets):
        return MoreRobust(start, np.inf, 0.0)

    def judged(one: Start, doubled: int) -> MoreRobust:
        scatter = Scatter(study, robust, *one[0].decode(one[1]))
        zs = normals(scatter, study.seed + 3)[:JUDGED]
        values = np.array([objective.value(shape) for shape in scatter.shapes(objective, forward, [*zs])])
        values = np.where(np.isfinite(values), values, np.inf)
        return MoreRobust(one, float(values.mean()), float((values <= tolerance).mean()), doubled)

    def lowered(one: Start) -> Start:
        return descend(study, robust, one, objective, forward, going=going)

    space = replace(start[0], vary_positions=study.positions)
    start = space, space.encode(*start[0].decode(start[1]))
    best = judged(start, 0)
    moved = judged(lowered(start), 0)
    best = moved if moved.gains_on(best, robust, 0.0) else best
    most = study.muscles.most if study.muscles is not None and study.positions else 0
    current, failed = best, 0
    while current.muscles < most and failed < PATIENCE and going():
        if robust.choose == "yield" and best.yielded >= ENOUGH:
            break
        wider = _doubled(study, robust, current.start, objective, forward)
        if wider is None:
            break
        current = judged(lowered(wider), current.doubled + 1)
        if current.gains_on(best, robust, study.price.muscle):
            best, failed = current, 0
        else:
            failed += 1
    return best


def _doubled(study: Study, robust: Robust, start: Start, objective: Objective, forward: Predictor) -> Start | None:
    """Return that of the layouts with one muscle laid as two whose copies are nearest in the mean; None where none
    fits."""
    count = len(start[0].design.muscles)
    starts = [option for k in range(count) for share in SHARES if (option := doubled(start, k, share)) is not None]
    values = _or_infinite([objective.value(shape) for shape in objective.shapes(forward, starts)]) if starts else []
    nearest = [starts[i] for i in np.argsort(values)[:TRIED]]
    if not nearest:
        return None
    means = []
    for option in nearest:
        copies = Copies(study, robust, objective, forward, option[0])
        means.append(copies.together.value(copies.shapes([option[1]])[0]))
    return nearest[int(np.argmin(_or_infinite(means)))]


def _or_infinite(values: Sequence[float]) -> list[float]:
    return [value if np.isfinite(value) else np.inf for value in values]
