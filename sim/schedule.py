"""The batch that lies in the fields, and the schedule of its lanes: each takes steps of its own, all of them their k-th
together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.forces.added import AddedForce
from sim.forces.contact import Touching
from sim.grid import Support
from sim.kernels.fields import LANES, F
from sim.kernels.transfer import on_grid, take
from sim.time_steps import Integrator, Scheme, Steps


@dataclass(frozen=True)
class Batch:
    """Its sizes, and what of it is read back."""

    blocks: int
    nu: int
    nv: int
    points: int  # fixed points, the most of any lane; 0 without muscles
    support: Support
    smoothing: int  # nodes over which the preconditioner's frames are averaged, to each side
    touching: Touching | None = None  # with self_contact
    added: tuple[AddedForce, ...] = ()  # forces of effects

    @property
    def grid(self) -> tuple[int, int, int]:
        return self.blocks, self.nu, self.nv

    def positions(self, plane: int) -> NDArray[np.float32]:
        """Return (lanes, n, n, 3) m, in a plane of F.node3."""
        return on_grid(F.node3, self.grid, plane)

    def states(self) -> NDArray[np.float32]:
        """Return (lanes, points, 2): contraction and tension [N] of every interval as last evaluated."""
        state = take(self.blocks, ("eps", "tension"))
        by_lane = np.stack([state[name][:, : self.points].swapaxes(1, 2) for name in ("eps", "tension")], axis=-1)
        return by_lane.reshape(self.blocks * LANES, self.points, 2)


PLAIN, FACTORISED, IDLE = range(3)  # what a block does: a step, one with the preconditioner factored anew, nothing
Floats = NDArray[np.float32]
Ints = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Schedule:
    """S steps of all lanes, and the frames that are kept of them."""

    scheme: Floats  # (S, blocks, entries of F.scheme, LANES)
    work: Ints  # (S, blocks) PLAIN; FACTORISED where a lane's scheme is another than before; IDLE after all lanes' ends
    pressure: Floats  # (S, blocks, channels, LANES) Pa
    first: Ints  # (S + 1, blocks, LANES): a lane's frames from first[k] until first[k + 1] fall into step k
    theta: Floats  # (frames or 1,) the fraction of its step at which a frame lies
    frame_updates: int  # in so many of a step's first iterations the preconditioner's frames follow the shape
    halts: bool = False  # whether velocities and accelerations are zeroed after the last step

    def part(self, begin: int, end: int) -> "Schedule":
        steps = slice(begin, end)
        return replace(
            self, scheme=self.scheme[steps], work=self.work[steps], pressure=self.pressure[steps],
            first=self.first[begin : end + 1],
        )  # fmt: skip


def alike(batch: Batch, scheme: Scheme, pressure: Floats, *, anew: bool = True, halts: bool = False) -> Schedule:
    """Return the same step for all lanes under `pressure` (S, blocks, channels, LANES) Pa, no frames. anew: whether the
    steps before it, if any, were others."""
    steps = len(pressure)
    entries = np.array(scheme.entries(batch.support), np.float32)
    work = np.full((steps, batch.blocks), PLAIN, np.int32)
    work[0] = FACTORISED if anew else PLAIN
    return Schedule(
        scheme=np.broadcast_to(entries[:, None], (steps, batch.blocks, len(entries), LANES)).copy(),
        work=work,
        pressure=np.ascontiguousarray(pressure, np.float32),
        first=np.zeros((steps + 1, batch.blocks, LANES), np.int32),
        theta=np.zeros(1, np.float32),
        frame_updates=2,  # the first guess of a long step may be far off
        halts=halts,
    )


def by_block(values: NDArray[np.floating[Any]]) -> Floats:
    """Return (..., entries, lanes) as (..., blocks, entries, LANES), as the fields have it."""
    apart = values.reshape(*values.shape[:-1], -1, LANES)
    return np.ascontiguousarray(np.swapaxes(apart, -3, -2), np.float32)


def of_motions(
    batch: Batch, packed: Sequence[int], motions: Sequence[Steps], *, tick: float, rho: float
) -> tuple[Schedule, NDArray[np.int_]]:
    """Return the steps of `motions`, of which lane k takes motions[packed[k]], by generalised-alpha with spectral
    radius rho at infinity and the midpoint rule through jumps; a lane that has come to its end goes on as it was. And
    (motions + 1,) where the frames of each begin among all."""
    lanes = [motions[i] for i in packed]
    count = max(len(motion.ticks) for motion in lanes)
    step_of = np.minimum(np.arange(count)[:, None], [len(m.ticks) - 1 for m in lanes])  # (S, lanes) their own steps
    numbered = list(enumerate(lanes))
    scheme_of = np.stack([2 * m.ticks[step_of[:, k]] + m.jumps[step_of[:, k]] for k, m in numbered], axis=1)
    distinct, code = np.unique(scheme_of, return_inverse=True)
    schemes = [
        Scheme(tick * float(k // 2), Integrator.MIDPOINT if k % 2 else Integrator.GENERALISED_ALPHA, rho)
        for k in distinct
    ]
    entries = np.array([scheme.entries(batch.support) for scheme in schemes], np.float32)
    channels = max(1, *(m.pressure.shape[1] for m in lanes))
    pressure = np.zeros((count, channels, len(lanes)))
    for k, m in numbered:
        pressure[:, : m.pressure.shape[1], k] = m.pressure[step_of[:, k]]
    begins = np.concatenate([[0], np.cumsum([len(m.due) for m in motions])])
    first = np.zeros((count + 1, len(lanes)), np.int32)
    for i, m in enumerate(motions):
        first[:, packed.index(i)] = begins[i] + np.searchsorted(m.due, np.arange(count + 1))
    blocks = batch.blocks, LANES
    change = (np.diff(scheme_of, axis=0, prepend=-1) != 0).reshape(count, *blocks).any(axis=2)
    ends = np.array([len(m.ticks) for m in lanes]).reshape(blocks).max(axis=1)
    idle = np.arange(count)[:, None] >= ends
    theta = np.concatenate([m.theta for m in motions])
    schedule = Schedule(
        scheme=by_block(np.swapaxes(entries[code.reshape(scheme_of.shape)], 1, 2)),
        work=np.where(idle, IDLE, np.where(change, FACTORISED, PLAIN)).astype(np.int32),
        pressure=by_block(pressure),
        first=first.reshape(count + 1, *blocks),
        theta=(theta if len(theta) else np.zeros(1)).astype(np.float32),
        frame_updates=1,
    )
    return schedule, begins
