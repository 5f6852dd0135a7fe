"""Time integration: which rule a step follows, when the steps of a motion begin, and which frames they hold."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import ActingPressure
from fabdesign.nouns.array import Array
from fabdesign.nouns.pressure import PressureProgram
from sim.grid import Support

GOES_ON = 0.75  # of an acceleration: vibrations that a step cannot resolve do not go on

# What the kernels take of a lane's step, entries of F.scheme
ENTRIES = {
    "H": "h [s]",
    "AM": "alpha_m",
    "AF": "alpha_f",
    "GAMMA": "gamma",
    "IA": "1 / (beta h^2) [1/s^2]",
    "RY": "1 / (1 - alpha_f)",
    "BA": "1 / (2 beta) - 1",
    "CA": "d a / d q [1/s^2]",
    "CV": "d v / d q [1/s]",
    "KNOWN": "share of the acceleration before the step in its first guess",
    "CARRIED": "share of the residual that the step leaves that acts in the next one",
    "AGES": "time by which memory ages [s]",
    "LED": "share of the springs and dampers that lead (sim/forces/lead.py)",
}
H, AM, AF, GAMMA, IA, RY, BA, CA, CV, KNOWN, CARRIED, AGES, LED = range(len(ENTRIES))


class Integrator(Enum):
    """GENERALISED_ALPHA: Chung and Hulbert 1993. MIDPOINT: the implicit midpoint rule, which needs no acceleration from
    before and so keeps second order where the pressure jumps. BACKWARD_EULER: to rest."""

    GENERALISED_ALPHA = "generalised-alpha"
    MIDPOINT = "implicit midpoint"
    BACKWARD_EULER = "backward Euler"


@dataclass(frozen=True)
class Scheme:
    """One step of `h` seconds by `rule`; rho in [0, 1] is generalised-alpha's spectral radius at infinity. ages: the
    seconds by which the memory of forces ages, `h` by default, none on the way to where a motion starts."""

    h: float
    rule: Integrator
    rho: float = 0.6
    ages: float | None = None

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Return h, alpha_m, alpha_f, gamma, 1 / (beta h^2), 1 / (1 - alpha_f), 1 / (2 beta) - 1."""
        if self.rule is Integrator.BACKWARD_EULER:
            return self.h, 0.0, 0.0, 1.0, 1.0 / self.h**2, 1.0, 0.0
        if self.rule is Integrator.MIDPOINT:
            return self.h, 0.0, 0.5, 1.0, 2.0 / self.h**2, 2.0, 0.0
        am, af = (2 * self.rho - 1) / (self.rho + 1), self.rho / (self.rho + 1)
        gamma, beta = 0.5 - am + af, 0.25 * (1 - am + af) ** 2
        return self.h, am, af, gamma, 1 / (beta * self.h**2), 1 / (1 - af), 0.5 / beta - 1

    @property
    def ca(self) -> float:
        """Return d a / d q [1/s^2]."""
        _, am, _, _, ia, ry, _ = self.coefficients
        return (1 - am) * ia * ry

    @property
    def cv(self) -> float:
        """Return d v / d q [1/s]."""
        h, _, _, gamma, ia, _, _ = self.coefficients
        return h * gamma * ia

    def entries(self, support: Support) -> tuple[float, ...]:
        """Return the coefficients in the order of ENTRIES. An acceleration is not known through a jump or to rest.
        Where no edge is held, long steps to rest have no use for the residual that they carry over: it keeps them from
        resting."""
        known = GOES_ON if self.rule is Integrator.GENERALISED_ALPHA else 0.0
        carried = 0.0 if not support.is_edge and self.rule is Integrator.BACKWARD_EULER else 1.0
        ages = self.h if self.ages is None else self.ages
        return *self.coefficients, self.ca, self.cv, known, carried, ages, 0.0


AFTER_JUMP = ((1 / 240, 1), (1 / 40, 2), (1 / 15, 4))  # s after a large jump, ticks of a step until then
LARGE = 50e3  # Pa, a jump that needs them
JUMP = 1e3  # Pa between one step and the next


@dataclass(frozen=True)
class Jumps:
    """Ticks in which a set point of a program moves by more than JUMP, and by more than LARGE; rest is at zero."""

    every: tuple[int, ...]
    large: tuple[int, ...]


def together(several: Sequence[Jumps]) -> Jumps:
    """Return all of them."""
    return Jumps(
        tuple(sorted({tick for one in several for tick in one.every})),
        tuple(sorted({tick for one in several for tick in one.large})),
    )


@dataclass(frozen=True, eq=False)
class Steps:
    """The steps of one motion."""

    ticks: NDArray[np.int_]  # (S,) of each
    jumps: NDArray[np.bool_]  # (S,) whether a pressure jumps within it
    pressure: Array  # (S, channels) Pa, means
    due: NDArray[np.int_]  # (T,) the step that each frame falls into
    theta: Array  # (T,) and at which fraction of it
    # end [s], number of steps, jumps, begin: motions alike in it ride together, others beside those with as many steps
    pattern: tuple[float, int, tuple[int, ...], tuple[int, ...], int]

    def evaluated(self, tick: float, rho: float) -> Array:
        """Return (S,) s after the first begins, at which they are evaluated. tick: s; rho: of generalised-alpha."""
        rules = Integrator.GENERALISED_ALPHA, Integrator.MIDPOINT
        before_end = np.array([Scheme(tick, rule, rho).coefficients[AF] for rule in rules])
        return np.asarray(tick * (np.cumsum(self.ticks) - before_end[self.jumps.astype(int)] * self.ticks))


def ticks_until(times: Array, tick: float) -> int:
    """Return ticks until the last of `times` [s]."""
    return max(1, int(np.ceil(times[-1] / tick - 1e-6))) if len(times) else 1


def steps_of(acting: ActingPressure, times: Array, jumps: Jumps, *, calm: int, begin: int = 0) -> Steps:
    """Return the steps of whole ticks of `acting`, `calm` ticks far from jumps, from tick `begin` to its end; frames at
    `times` (T,) s."""
    edges = step_edges(acting.ticks, jumps.large, tick=acting.tick, calm=calm, begin=begin)
    instants = np.asarray(acting.tick * edges, dtype=np.float64)
    due = np.clip(np.searchsorted(instants, times - 1e-9) - 1, 0, len(edges) - 2)
    within = np.searchsorted(jumps.every, edges)
    return Steps(
        ticks=np.diff(edges),
        jumps=np.diff(within) > 0,
        pressure=acting.between(edges),
        due=due,
        theta=np.clip((times - instants[due]) / np.diff(instants)[due], 0.0, 1.0),
        pattern=(times[-1] if len(times) else 0.0, len(edges), jumps.large, jumps.every, begin),
    )


@lru_cache(maxsize=256)
def step_edges(ticks: int, jumps: Sequence[int], *, tick: float, calm: int, begin: int = 0) -> NDArray[np.int_]:
    """Return (steps + 1,) ticks (of `tick` s), from `begin` on, between which steps lie: AFTER_JUMP says how many a
    step has after each jump, `calm` else."""
    longest = np.full(ticks + calm, calm)
    for jump in jumps:
        for duration, most in AFTER_JUMP:
            until = jump + round(duration / tick)
            longest[jump:until] = np.minimum(longest[jump:until], most)
    counts = sorted({calm, *(most for _, most in AFTER_JUMP)}, reverse=True)
    edges = [begin]
    while edges[-1] < ticks:
        k = edges[-1]
        edges.append(k + next(c for c in counts if longest[k : k + c].min() >= c))
    kept = np.array(edges)
    kept.flags.writeable = False
    return kept


def jumps_of(program: PressureProgram, tick: float, *, released: bool = False) -> Jumps:
    """Return the jumps of a program. released: whether the cloth starts where it is not in equilibrium, as if a
    pressure jumped."""
    last = int(np.ceil(program.time[-1] / tick)) + 2
    pressure = program.means(np.linspace(0.0, tick * last, last + 1))
    change = np.abs(np.diff(np.concatenate([np.zeros((1, pressure.shape[1])), pressure]), axis=0)).max(
        axis=1, initial=0
    )
    if released:
        change[0] = np.inf
    every, large = (tuple(int(k) for k in np.flatnonzero(change > least)) for least in (JUMP, LARGE))
    return Jumps(every, large)
