"""When the steps of a motion begin, which rule and pressures they have, and which frames they hold."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.pressures import ActingPressure
from fabdesign.nouns.pressure import PressureProgram

Array = NDArray[np.float64]
AFTER_JUMP = ((1 / 240, 1), (1 / 40, 2), (1 / 15, 4))  # s after a large jump, ticks of a step until then
LARGE = 50e3  # Pa, a jump that needs them
JUMP = 1e3  # Pa between one step and the next


@dataclass(frozen=True)
class Jumps:
    """Ticks in which a set point of a program moves by more than JUMP, and by more than LARGE; rest is at zero."""

    every: tuple[int, ...]
    large: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Steps:
    """The steps of one motion."""

    ticks: NDArray[np.int_]  # (S,) of each
    jumps: NDArray[np.bool_]  # (S,) whether a pressure jumps within it
    pressure: Array  # (S, channels) Pa, means
    due: NDArray[np.int_]  # (T,) the step that each frame falls into
    theta: Array  # (T,) and at which fraction of it
    # end [s], number of steps, jumps: motions alike in it ride together, others beside those with as many steps
    pattern: tuple[float, int, tuple[int, ...], tuple[int, ...]]


def steps_of(acting: ActingPressure, times: Array, jumps: Jumps, *, calm: int) -> Steps:
    """Steps of whole ticks of `acting`, `calm` ticks far from jumps, to its end; frames at `times` (T,) s."""
    edges = step_edges(acting.ticks, jumps.large, tick=acting.tick, calm=calm)
    instants = np.asarray(acting.tick * edges, dtype=np.float64)
    due = np.clip(np.searchsorted(instants, times - 1e-9) - 1, 0, len(edges) - 2)
    within = np.searchsorted(jumps.every, edges)
    return Steps(
        ticks=np.diff(edges),
        jumps=np.diff(within) > 0,
        pressure=acting.between(edges),
        due=due,
        theta=np.clip((times - instants[due]) / np.diff(instants)[due], 0.0, 1.0),
        pattern=(times[-1] if len(times) else 0.0, len(edges), jumps.large, jumps.every),
    )


@lru_cache(maxsize=256)
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
    kept = np.array(edges)
    kept.flags.writeable = False
    return kept


def jumps_of(program: PressureProgram, tick: float, *, released: bool = False) -> Jumps:
    """released: whether the cloth starts where it is not in equilibrium, as if a pressure jumped."""
    last = int(np.ceil(program.time[-1] / tick)) + 2
    pressure = program.means(np.linspace(0.0, tick * last, last + 1))
    change = np.abs(np.diff(np.concatenate([np.zeros((1, pressure.shape[1])), pressure]), axis=0)).max(
        axis=1, initial=0
    )
    if released:
        change[0] = np.inf
    every, large = (tuple(int(k) for k in np.flatnonzero(change > least)) for least in (JUMP, LARGE))
    return Jumps(every, large)
