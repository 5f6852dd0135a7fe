"""When the steps of a motion begin, and which pressures they hold."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.pressure import PressureProgram
from sim.fields import LANES

Array = NDArray[np.float64]
AFTER_JUMP = ((1 / 240, 1), (1 / 40, 2), (1 / 15, 4))  # s after a large jump, ticks of a step until then
LARGE = 50e3  # Pa, a jump that needs them
JUMP = 1e3  # Pa between one step and the next


@dataclass(frozen=True)
class Jumps:
    """Ticks in which a set point of a program moves by more than JUMP, and by more than LARGE; rest is at zero."""

    every: tuple[int, ...]
    large: tuple[int, ...]


def step_edges(ticks: int, jumps: Sequence[int], *, tick: float, calm: int) -> NDArray[np.int_]:
    """(steps + 1,) ticks (of `tick` s) between which steps lie: AFTER_JUMP says how many a step has after each jump,
    `calm` else."""
    longest = np.full(ticks + calm, calm)
    for jump in jumps:
        for duration, most in AFTER_JUMP:
            until = jump + round(duration / tick)
            longest[jump:until] = np.minimum(longest[jump:until], most)
    counts = sorted({calm, *(most for _, most in AFTER_JUMP)}, reverse=True)
    edges = [0]
    while edges[-1] < ticks:
        k = edges[-1]
        edges.append(k + next(c for c in counts if longest[k : k + c].min() >= c))
    return np.array(edges)


def jumps_of(program: PressureProgram, tick: float) -> Jumps:
    last = int(np.ceil(program.time[-1] / tick)) + 2
    pressure = program.means(np.linspace(0.0, tick * last, last + 1))
    change = np.abs(np.diff(np.concatenate([np.zeros((1, pressure.shape[1])), pressure]), axis=0)).max(
        axis=1, initial=0
    )
    every, large = (tuple(int(k) for k in np.flatnonzero(change > least)) for least in (JUMP, LARGE))
    return Jumps(every, large)


def stack_pressures(programs: list[NDArray], blocks: int) -> NDArray[np.float32]:
    """(steps, blocks, channels, LANES) Pa; lanes without a design repeat the last one."""
    steps, channels = programs[0].shape[0], max(max(1, p.shape[1]) for p in programs)
    out = np.zeros((steps, blocks, channels, LANES), np.float32)
    for lane in range(blocks * LANES):
        p = programs[min(lane, len(programs) - 1)]
        out[:, lane // LANES, : p.shape[1], lane % LANES] = p
    return out
