"""The settings of a simulator: grid, time steps, tolerance, and how pressures rise to a shape at rest."""

from dataclasses import dataclass, replace
from typing import Self

from fabdesign.errors import InputError, require_number
from fabdesign.nouns.forward import HOLD, RISE
from fabdesign.nouns.model import POINTS_PER_SIDE
from fabdesign.runtime.effort import COARSEST, FINEST, LONGEST

TIME_STEPS = 1e-6, 1 / 240  # s
MOST_CALM, MOST_ITERATIONS = 64, 1000
TOLERANCES = 1e-12, 1e-3  # m
RISES = 0.01, 60.0  # s


@dataclass(frozen=True)
class Settings:
    """The options of a simulator. Raises InputError where an option is out of range."""

    points_per_side: int = POINTS_PER_SIDE
    time_step: float = 1 / 1920  # s, right after a jump of pressure; more in one as time goes on (sim/time_steps.py)
    calm_steps: int | None = None  # time steps in one, later on; 8 by default, on finer grids 4, with self_contact 1
    iterations: int = 16  # at most, in a step
    tolerance: float = 2e-7  # m, RMS over nodes of a step's last update; what it still lacks the next step makes up
    rho: float = 0.6  # spectral radius at infinity of generalised-alpha
    self_contact: bool = False  # whether layers of the cloth keep a thickness apart
    rise: float = RISE  # s, in which pressures rise on the way to an equilibrium
    hold: float = HOLD  # s, for which they then hold, where effects remember

    def __post_init__(self) -> None:
        require_number("points_per_side", self.points_per_side, COARSEST, FINEST, kind=int)
        require_number("time_step", self.time_step, *TIME_STEPS, unit=" s")
        if self.calm_steps is not None:
            require_number("calm_steps", self.calm_steps, 1, MOST_CALM, kind=int)
        require_number("iterations", self.iterations, 1, MOST_ITERATIONS, kind=int)
        require_number("tolerance", self.tolerance, *TOLERANCES, unit=" m")
        require_number("rho", self.rho, 0, 1)
        require_number("rise", self.rise, *RISES, unit=" s")
        require_number("hold", self.hold, 0, LONGEST, unit=" s")
        if not isinstance(self.self_contact, bool):
            raise InputError(f"self_contact is {self.self_contact!r}; expected True or False")

    @property
    def calm(self) -> int:
        return self.calm_steps or (1 if self.self_contact else 8 if self.points_per_side <= 41 else 4)

    def finer(self) -> Self:
        """Return the same with half the steps and twice the iterations."""
        return replace(
            self,
            time_step=max(self.time_step / 2, TIME_STEPS[0]),
            calm_steps=max(1, self.calm // 2),
            iterations=min(2 * self.iterations, MOST_ITERATIONS),
        )
