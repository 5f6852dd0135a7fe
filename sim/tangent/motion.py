"""How frames of a motion change with parameters where forces balance with inertia and damping, and what a cloth that
was seen has of these beyond the motion's.

With d from the motion's frame to the cloth seen, K d + C d' + M d'' = F dtheta to first order (d'Alembert; equation
error in system identification). d' and d'' are seen; springs sigma M on both sides bound what noise in them does:
(K + sigma M) d = F dtheta + M (sigma d - d'') - C d'. A motion that is led is in balance with the known pull M g too,
which the cloth seen is without: M (sigma d - d'' - g).
"""

from collections.abc import Sequence

import numpy as np

from fabdesign.effects.acting import acting_pressure
from fabdesign.nouns.array import Array
from fabdesign.nouns.column import SPRINGS, Balance
from fabdesign.nouns.forward import Case, Instant
from sim.kernels.transfer import put
from sim.loading import ringed
from sim.schedule import Batch
from sim.tangent.conjugate_gradients import SOLVED
from sim.tangent.explicit import LaneColumns, MovedCases
from sim.tangent.shape_kernels import write_column
from sim.tangent.shapes import Balanced, Solved

FARTHEST = 5e-3  # m, RMS from a frame to where its forces balance: farther off its acceleration was not resolved


def solve_in_motion(
    batch: Batch, lanes: Sequence[LaneColumns], cases: MovedCases, instants: Sequence[Instant]
) -> list[Solved]:
    """Return the responses (k, n, n, 3) m of the lanes of a batch, each at an instant, as their middle, and the columns
    solved."""
    middle = ringed(np.array([one.middle for one in instants]))
    velocity = ringed(np.array([one.velocity for one in instants]))
    acceleration = ringed(np.array([one.acceleration - one.pull for one in instants]))
    put(batch.blocks, {"x0": middle, "q": middle, "v0": velocity, "a0": acceleration})
    balanced = Balanced(batch, lanes, cases, springs=SPRINGS, farthest=FARTHEST)
    changes = balanced.changes()
    loads = [SPRINGS * one.moved - one.moved_acceleration for one in instants]
    for one, load in zip(instants, loads, strict=True):
        load[0] -= one.pull  # of the cloth seen alone: what sensors do is no force
    forces = [
        mass[:, None] * load.reshape(len(load), -1, 3) for mass, load in zip(balanced.host.masses, loads, strict=True)
    ]
    count = len(forces[0])
    for slot in range(count):
        write_column(slot, balanced.at_nodes(np.array([force[slot] for force in forces])))
        put(batch.blocks, {"vp": ringed(np.array([one.moved_velocity[slot] for one in instants]))})
        balanced.add_viscous(slot, np.ones(len(lanes)))
    responses, outcomes = balanced.solved(count)
    sound = balanced.settled & (outcomes == SOLVED).all(axis=1)
    return [Solved(responses[k], bool(sound[k]), changes[k]) for k in range(len(lanes))]


def pressures_until(case: Case, until: float, tick: float) -> Array:
    """Return (ticks, channels) Pa that act at the ticks of a case, of `tick` s each, the last after `until` s."""
    means = acting_pressure(case, round(until / tick) + 2, tick).means
    return np.asarray(0.5 * (means + means[np.maximum(np.arange(len(means)) - 1, 0)]))


def balance_of(solved: Solved, count: int) -> Balance:
    """Return what was solved of a frame's `count` columns: zero for one that alone is not, which moves next to nothing,
    such as that of a muscle without pressure; NaN for all where the frame has no tangent."""
    changes = np.zeros((count, *solved.middle.shape[1:]), np.float32)
    for column, change in solved.changes.items():
        changes[column] = change
    nothing = 0.0 if solved.settled else np.nan
    return Balance(solved.middle + np.float32(nothing), changes + np.float32(nothing))
