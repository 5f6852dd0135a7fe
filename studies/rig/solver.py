"""Residual, stiffness and Newton iterations of one scene."""

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbtrf, dpbtrs

from fabdesign.errors import SimulationError
from studies.rig import cables as cable_kernels
from studies.rig import shell
from studies.rig.muscle import tension
from studies.rig.scene import Scene
from studies.rig.spline import GAUSS

Array = NDArray[np.float64]
TOLERANCE = 1e-7  # m, largest Newton correction of a control point that ends a step
HELD = 1e15  # N/m, on the diagonal of a held value
MAX_ITERATIONS = 60
KEEP = 0.35  # a factor that shrinks corrections at least so is kept


class RigDiverged(SimulationError):
    """Newton found no solution of a step; says when."""


class RigSolver:
    """One scene's moving state, its residual and its factored stiffness."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        s = scene
        self.band_width = _half_band(s)
        self.strain = np.zeros((len(s.uv), 6))
        self.memory = np.zeros((len(s.uv), 6))
        self.y = np.zeros((len(s.cables.uv), 3))
        m = s.cables.nodes.shape[1]
        self.jac = np.zeros((len(s.cables.uv), m, 3, 3))
        self.factor: Array | None = None
        self.weight_force = np.zeros(0)
        self._mass_band = _to_band(s.mass, self.band_width)
        self._drag_band = _to_band(s.drag, self.band_width)

    def internal(self, x: Array, pressure: Array, rate_gain: float, rate_history: Array, cable_history: Array) -> Array:
        """Return the internal force (n, 3) N at x. Rates are rate_gain * value + history."""
        s = self.scene
        out = np.zeros_like(x)
        shell.forces(
            x, s.nodes, s.basis, s.weight, s.stiffness, s.rest_strain, s.viscosity, s.prony, self.memory,
            rate_gain, rate_history, self.strain, out,
        )  # fmt: skip
        c = s.cables
        if len(c.rest):
            cable_kernels.positions(x, c.nodes, c.basis, c.offset, self.y, self.jac)
            length = np.linalg.norm(self.y[c.first + 1] - self.y[c.first], axis=1)
            self.contraction = 1.0 - length / c.rest
            rate = rate_gain * self.contraction + cable_history
            self.tension, slope = tension(s, pressure, self.contraction, rate, rate_gain)
            self.axial = -slope / c.rest  # N/m, tension gained per length
            cable_kernels.forces(self.y, self.jac, c.nodes, c.first, self.tension, out)
        else:
            self.contraction = self.tension = self.axial = np.zeros(0)
        if len(s.tied_to):
            out += s.ties.T @ (s.tie_stiffness[:, None] * (s.ties @ x - s.tied_to))
        return out

    def refactor(
        self, x: Array, rate_gain: float, rate_history: Array, mass_gain: float, drag_gain: float, exact: bool = True
    ) -> None:
        """Factor mass_gain M + drag_gain D + K at the state of the last residual.

        Where the exact stiffness is indefinite (about to buckle), its definite part serves.
        """
        s, c = self.scene, self.scene.cables
        band = mass_gain * self._mass_band + drag_gain * self._drag_band
        shell.stiffness(
            x, s.nodes, s.basis, s.weight, s.stiffness, s.rest_strain, s.viscosity, s.prony, self.memory,
            rate_gain, rate_history, GAUSS**2, exact, band,
        )  # fmt: skip
        if len(c.rest):
            cable_kernels.stiffness(
                self.y, self.jac, c.nodes, c.first, self.tension, np.maximum(self.axial, 0.0), exact, band
            )
        if len(s.tied_to):
            band += _to_band(s.ties.T @ sp.diags(s.tie_stiffness) @ s.ties, self.band_width)
        band[0, np.flatnonzero(s.held.ravel())] += HELD
        self.factor, info = dpbtrf(band, lower=1, overwrite_ab=1)
        if info and exact:
            self.refactor(x, rate_gain, rate_history, mass_gain, drag_gain, exact=False)
        elif info:
            raise RigDiverged("the stiffness matrix is singular: is the cloth held, and does it have mass?")

    def newton(self, x: Array, residual: Callable[[Array], Array], refactor: Callable[[Array], None]) -> Array:
        """Return the root of `residual` near x. The factor is kept while corrections shrink by 1 / KEEP, and damped
        where they would grow (natural monotonicity: Deuflhard 2011, "Newton Methods for Nonlinear Problems", 3.3)."""
        r = residual(x)
        fresh = self.factor is None
        if fresh:
            refactor(x)
        dx, damping = self.correction(r), 1.0
        for _ in range(MAX_ITERATIONS):
            size = float(np.abs(dx).max())
            if size < TOLERANCE:
                return x + dx
            trial = x + damping * dx
            r = residual(trial)
            next_dx = self.correction(r)
            ratio = float(np.linalg.norm(next_dx) / np.linalg.norm(dx))
            if ratio < KEEP and damping == 1.0:
                x, dx, fresh = trial, next_dx, False
                continue
            if fresh and not ratio < 1.0 - damping / 4:
                damping /= 2
                if damping < 1e-3:
                    break
                continue
            if ratio < 1.0:
                x = trial
            else:
                r = residual(x)
            refactor(x)
            dx, damping, fresh = self.correction(r), min(1.0, 2 * damping) if fresh else 1.0, True
        raise RigDiverged(f"no solution: the last correction was {size:.1e} m")

    def correction(self, residual: Array) -> Array:
        residual = np.where(self.scene.held, 0.0, residual)
        dx, _ = dpbtrs(self.factor, residual.reshape(-1, 1), lower=1)
        return np.asarray(-dx.reshape(residual.shape))


def _half_band(scene: Scene) -> int:
    widest = int((scene.nodes.max(axis=1) - scene.nodes.min(axis=1)).max())
    for j in scene.cables.first:
        pair = scene.cables.nodes[j : j + 2]
        widest = max(widest, int(pair.max() - pair.min()))
    for matrix in (scene.mass, scene.drag):
        coo = matrix.tocoo()
        widest = max(widest, int(np.abs(coo.row - coo.col).max(initial=0)))
    return 3 * widest + 2


def _to_band(matrix: sp.spmatrix, half: int) -> Array:
    """Return the lower band (half + 1, 3 n) of a scalar matrix that acts on x, y and z alike."""
    coo = matrix.tocoo()
    lower = coo.row >= coo.col
    row, col, data = coo.row[lower], coo.col[lower], coo.data[lower]
    band = np.zeros((half + 1, 3 * matrix.shape[0]), order="F")
    for c in range(3):
        band[3 * (row - col), 3 * col + c] = data
    return band
