"""Time integration: what rule a step follows."""

from dataclasses import dataclass
from enum import Enum

from sim.design.support import Support

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
}
H, AM, AF, GAMMA, IA, RY, BA, CA, CV, KNOWN, CARRIED, AGES = range(len(ENTRIES))


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
        """h, alpha_m, alpha_f, gamma, 1 / (beta h^2), 1 / (1 - alpha_f), 1 / (2 beta) - 1."""
        if self.rule is Integrator.BACKWARD_EULER:
            return self.h, 0.0, 0.0, 1.0, 1.0 / self.h**2, 1.0, 0.0
        if self.rule is Integrator.MIDPOINT:
            return self.h, 0.0, 0.5, 1.0, 2.0 / self.h**2, 2.0, 0.0
        am, af = (2 * self.rho - 1) / (self.rho + 1), self.rho / (self.rho + 1)
        gamma, beta = 0.5 - am + af, 0.25 * (1 - am + af) ** 2
        return self.h, am, af, gamma, 1 / (beta * self.h**2), 1 / (1 - af), 0.5 / beta - 1

    @property
    def ca(self) -> float:
        """d a / d q [1/s^2]."""
        _, am, _, _, ia, ry, _ = self.coefficients
        return (1 - am) * ia * ry

    @property
    def cv(self) -> float:
        """d v / d q [1/s]."""
        h, _, _, gamma, ia, _, _ = self.coefficients
        return h * gamma * ia

    def entries(self, support: Support) -> tuple[float, ...]:
        """Return the coefficients in the order of ENTRIES. An acceleration is not known through a jump or to rest.
        Where no edge is held, long steps to rest have no use for the residual that they carry over: it keeps them from
        resting."""
        known = GOES_ON if self.rule is Integrator.GENERALISED_ALPHA else 0.0
        carried = 0.0 if not support.is_edge and self.rule is Integrator.BACKWARD_EULER else 1.0
        ages = self.h if self.ages is None else self.ages
        return *self.coefficients, self.ca, self.cv, known, carried, ages
