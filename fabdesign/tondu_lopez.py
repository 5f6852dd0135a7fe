"""The textbook law of a McKibben muscle, fitted to a bench table beside our own."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fabdesign.errors import InputError

if TYPE_CHECKING:
    from fabdesign.muscle import BenchTable


@dataclass(frozen=True)
class TonduLopez:
    """F = pi r0^2 p [a (1 - k eps)^2 - b], a = 3 / tan^2 alpha0, b = 1 / sin^2 alpha0.

    Source: Tondu and Lopez 2000, IEEE Control Systems 20(2). It knows neither a threshold pressure nor the idle
    muscle's own stiffness: it describes what pressure adds to the tension, F(p, eps) - F(0, eps).
    """

    radius: float  # m, r0, of the tube at rest
    braid_angle: float  # rad, alpha0, between strand and axis
    end_factor: float  # k >= 1, for the conical ends
    misfit: float  # N, root mean square over the rows fitted
    worst: float  # N, largest over the rows fitted
    rows: int  # how many were fitted

    @staticmethod
    def fit(table: "BenchTable") -> "TonduLopez":
        """Least squares over rows with pressure > 0 and contraction >= 0 where pressure adds tension.

        Tension at zero pressure is interpolated from the table; a table without such rows counts as force-free there.
        Raises InputError for fewer than four rows.
        """
        from scipy.optimize import least_squares

        p, eps, force = (np.asarray(x, dtype=float) for x in (table.pressure, table.contraction, table.force))
        idle = (p == 0) & (eps >= 0)
        if idle.any():
            order = np.argsort(eps[idle])
            force = force - np.interp(eps, eps[idle][order], force[idle][order])
        used = (p > 0) & (eps >= 0) & (force > 0)
        if used.sum() < 4:
            raise InputError(f"bench table: {used.sum()} rows where pressure adds tension; expected at least 4")
        p, eps, force = p[used], eps[used], force[used]
        scale = force.max()

        def residual(x: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.asarray((_force(x[0] * 1e-3, x[1], x[2], p, eps) - force) / scale)

        bounds = ([0.05, math.radians(5), 1.0], [100.0, math.radians(54), 10.0])
        starts = ([1.0, math.radians(angle), 1.2] for angle in (15, 25, 40))
        best = min(
            (least_squares(residual, x0, bounds=bounds, x_scale=[1, 0.1, 1]) for x0 in starts), key=lambda r: r.cost
        )
        error = scale * best.fun
        return TonduLopez(
            radius=float(best.x[0] * 1e-3),
            braid_angle=float(best.x[1]),
            end_factor=float(best.x[2]),
            misfit=float(np.sqrt(np.mean(error**2))),
            worst=float(np.abs(error).max()),
            rows=int(used.sum()),
        )

    def tension(self, pressure_pa: ArrayLike, contraction: ArrayLike) -> NDArray[np.float64]:
        """Tension [N] that pressure adds, over gauge pressure [Pa] and contraction; the arguments broadcast."""
        p, eps = np.asarray(pressure_pa, dtype=float), np.asarray(contraction, dtype=float)
        return _force(self.radius, self.braid_angle, self.end_factor, p, eps)


def _force(
    radius: float, angle: float, end_factor: float, p: NDArray[np.float64], eps: NDArray[np.float64]
) -> NDArray[np.float64]:
    a, b = 3 / math.tan(angle) ** 2, 1 / math.sin(angle) ** 2
    return np.asarray(math.pi * radius**2 * p * (a * (1 - end_factor * eps) ** 2 - b))
