"""Time integration and sizes of a batch."""

from dataclasses import dataclass

from sim.design.support import FREE
from sim.forces.contact_pairs import Touching

MIDPOINT = 2.0  # Scheme.rho of the implicit midpoint rule
GOES_ON = 0.75  # of an acceleration: vibrations that a step cannot resolve do not go on


@dataclass(frozen=True)
class Scheme:
    """Coefficients of one step of `h` seconds.

    rho in [0, 1]: generalised-alpha. rho = MIDPOINT: the implicit midpoint rule, which needs no acceleration from
    before and so keeps second order where the pressure jumps. rho < 0: backward Euler.
    """

    h: float
    rho: float

    @property
    def coefficients(self) -> tuple[float, ...]:
        """h, alpha_m, alpha_f, gamma, 1 / (beta h^2), 1 / (1 - alpha_f), 1 / (2 beta) - 1."""
        if self.rho < 0:
            return self.h, 0.0, 0.0, 1.0, 1.0 / self.h**2, 1.0, 0.0
        if self.rho == MIDPOINT:
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

    def entries(self, hung: int) -> tuple[float, ...]:
        """Of F.scheme: the coefficients; ca and cv; the share of the acceleration before the step in its first guess,
        none through a jump or to rest; the share of what the step lacks that the next one makes up."""
        goes_on = GOES_ON if 0 <= self.rho <= 1 else 0.0
        # where nodes are held one by one, long steps to rest have no use for what they carry: it keeps them from
        # resting
        carried = 0.0 if hung == FREE and self.rho < 0 else 1.0
        return *self.coefficients, self.ca, self.cv, goes_on, carried


@dataclass(frozen=True)
class Batch:
    """Sizes of the batch that lies in the fields."""

    blocks: int
    nu: int
    nv: int
    points: int  # fixed points, the most of any lane; 0 without muscles
    hung: int  # 0 top, 1 bottom, 2 left, 3 right, 4 none or points
    reach: int  # nodes over which the preconditioner's frames are averaged
    touching: Touching | None = None  # with self_contact

    @property
    def grid(self) -> tuple[int, int, int]:
        return self.blocks, self.nu, self.nv
