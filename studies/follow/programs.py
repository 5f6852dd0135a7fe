"""Programs at the regulator's cycle: what they may be, and the best change of one."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.pressure import PressureProgram, limits, regulated, slewed
from fabdesign.study_files.follow_file import FollowStudy

UNIT = 1e5  # Pa, that changes are computed in
ROUGH = 0.5  # of UNIT: prior standard deviation of the second difference of set points from cycle to cycle
SMOOTH = 24.0  # UNIT/s^2: the same of the second derivative between poses, where little else holds it
TURN = 2.0  # of UNIT: that of the first
TINY = 1e-9


@dataclass(frozen=True)
class Regulator:
    """The limits that the pressures keep. lowest, highest (channels,) Pa; rate Pa/s, inf where steps are possible.
    rough: of UNIT, the prior standard deviation of their second difference."""

    cycle: float  # s
    resolution: float  # Pa
    lowest: Array
    highest: Array
    rate: float
    rough: float = ROUGH

    @property
    def channels(self) -> int:
        return len(self.highest)

    @property
    def change(self) -> float:
        """Return Pa, from one cycle to the next, at most; a rounding's room is kept."""
        return self.rate * self.cycle - self.resolution if np.isfinite(self.rate) else np.inf

    def program(self, pressures: Array) -> PressureProgram:
        """Return the program of set points (cycles, channels) Pa, one a cycle."""
        times = self._instants(len(pressures))
        return PressureProgram(times, pressures, self.cycle * len(pressures))

    def rows(self, program: PressureProgram, cycles: int) -> Array:
        """Return the set points (cycles, channels) Pa of any program."""
        return program.at(self._instants(cycles))

    def cycles(self, until: float) -> int:
        """Return how many set points act before an instant [s]."""
        return int(np.ceil(until / self.cycle - 1e-6))

    def _instants(self, cycles: int) -> Array:
        """Return the times [s] of set points, as a file shows them."""
        return np.round(self.cycle * np.arange(cycles), 9)

    def kept(self, pressures: Array) -> Array:
        """Return set points (cycles, channels) Pa that keep resolution, limits and, from rest on, the rate."""
        rounded = regulated(np.clip(pressures, self.lowest, self.highest), self.resolution)
        return slewed(rounded, self.change, self.resolution) if np.isfinite(self.rate) else rounded


def regulator_of(study: FollowStudy) -> Regulator:
    """Return what the study's pressures keep."""
    rig = study.rig
    most = regulated(np.minimum(limits(study.design), min(rig.pressure, rig.supply or np.inf)), rig.resolution)
    rough = min(ROUGH, SMOOTH * rig.cycle**2) if isinstance(study.target, tuple) else ROUGH
    return Regulator(rig.cycle, rig.resolution, np.zeros(study.design.channels), most, rig.rate, rough)


def case_of(study: FollowStudy, program: PressureProgram) -> Case:
    """Return the study's design under a program, behind the regulator's delay."""
    delay = (Term("dead_time", {"delay": study.rig.delay}),) if study.rig.delay else ()
    return Case(study.design, program, effects=delay, order=study.order)


@dataclass(frozen=True, eq=False)
class Roughness:
    """The prior of smooth programs: their negative log density, less a constant, and how it changes, in UNIT."""

    value: float
    gradient: Array  # (n,), n = count channels
    hessian: Array  # (n, n)

    @staticmethod
    def of(before: Array, pressures: Array, rough: float = ROUGH) -> "Roughness":
        """Return it by the rows `before` (2, channels) Pa that precede `pressures` (count, channels) Pa."""
        count, channels = pressures.shape
        rows = np.concatenate([before, pressures]) / UNIT
        first = np.diff(np.eye(count + 2), axis=0)[1:] / TURN
        second = np.diff(np.eye(count + 2), 2, axis=0) / rough
        weights = first.T @ first + second.T @ second
        bent = weights @ rows
        value = float((rows * bent).sum())
        hessian = np.asarray(np.kron(weights[2:, 2:], np.eye(channels)), np.float64)
        return Roughness(value, bent[2:].ravel(), hessian)


def best_change(hessian: Array, gradient: Array, regulator: Regulator, rows: tuple[Array, Array], most: float) -> Array:
    """Return the change (count, channels) Pa that lowers g x + x H x / 2 most, x in UNIT, within limits and rate, no
    set point by more than `most` Pa. rows: the one that precedes, (channels,) Pa, and those that change."""
    before, pressures = rows
    count, channels = pressures.shape
    eye: Array = np.eye(count * channels)
    matrix = [eye, -eye]
    least = [np.maximum(regulator.lowest - pressures, -most), -np.minimum(regulator.highest - pressures, most)]
    if np.isfinite(regulator.rate):
        step = np.asarray(np.kron(np.diff(np.eye(count + 1), axis=0)[:, 1:], np.eye(channels)), np.float64)
        now = np.diff(np.concatenate([before[None], pressures]), axis=0)
        room = max(regulator.change, 0.0)
        matrix += [step, -step]
        least += [np.minimum(-room - now, 0.0), np.minimum(now - room, 0.0)]
    bounds = np.concatenate(least).ravel() / UNIT
    return UNIT * _least_distance(hessian, gradient, np.concatenate(matrix), bounds).reshape(count, channels)


def _least_distance(hessian: Array, gradient: Array, matrix: Array, least: Array) -> Array:
    """Return x that lowers g x + x H x / 2 with matrix x >= least: the least distance problem of Lawson and Hanson
    (1974, chapter 23), by non-negative least squares. Zero must be allowed."""
    root = np.linalg.cholesky(hessian + TINY * np.trace(hessian) * np.eye(len(hessian)))
    inverse = np.linalg.inv(root)
    free = inverse @ gradient
    rows = matrix @ inverse.T
    right = least + rows @ free
    system = np.concatenate([rows.T, right[None]])
    goal = np.zeros(len(system))
    goal[-1] = 1.0
    dual, _ = nnls(system, goal, maxiter=50 * len(right))
    residual = system @ dual - goal
    y = -residual[:-1] / residual[-1] if abs(residual[-1]) > TINY else free
    return np.asarray(inverse.T @ (y - free))
