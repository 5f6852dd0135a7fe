"""A forward model in closed form, for tests of what lies above the simulator.

Every muscle spreads curvature along its direction around its path; columns of the cloth keep their length and turn
by what is integrated down from the top. Smooth, nonlinear in pressure and place, and 1,000 times faster.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.column import Column, FacesJacobian, move
from fabdesign.nouns.forward import Case

SPREAD = 0.02  # m, of a muscle's curvature across its path
CURVATURE = 12.0  # 1/m, of a full-length muscle at full pressure


@dataclass
class AnalyticCloth:
    """A ForwardModel whose motions rise as 1 - exp(-5 t). `fail_above`: channel 0 above this [Pa] diverges."""

    points_per_side: int = 41
    fail_above: float = np.inf
    calls: int = 0

    def motions(self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float32]]:
        self.calls += 1
        return [
            np.array([self._shape(case, 1 - np.exp(-5 * t)) for t in at]) for case, at in zip(cases, times, strict=True)
        ]

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        self.calls += 1
        return [self._shape(case, 1.0) for case in cases]

    def _shape(self, case: Case, share: float) -> NDArray[np.float32]:
        fabric, pressures, n = case.design.fabric, case.program.pressure[-1], self.points_per_side
        if len(pressures) and pressures[0] > self.fail_above:
            return np.full((2 * n * n, 3), np.nan, np.float32)
        u, v = np.meshgrid(np.linspace(0, fabric.width, n), np.linspace(0, fabric.height, n))
        down, across = np.zeros_like(u), np.zeros_like(u)
        for muscle in case.design.muscles:
            sign = 1.0 if muscle.side == "front" else -1.0
            pull = np.tanh(pressures[muscle.channel] / 250e3) ** 2
            corners = np.array(muscle.path)
            for a, b in pairwise(corners):
                length = np.linalg.norm(b - a)
                along = (b - a) / length
                s = np.clip((u - a[0]) * along[0] + (v - a[1]) * along[1], 0, length)
                gap2 = (u - a[0] - s * along[0]) ** 2 + (v - a[1] - s * along[1]) ** 2
                field = sign * pull * CURVATURE * np.exp(-gap2 / (2 * SPREAD**2))
                down += field * along[1] ** 2
                across += field * along[0] ** 2
        h = fabric.height / (n - 1)
        turn = share * np.cumsum(down, axis=0) * h
        slope = share * np.cumsum(across - across[:, n // 2, None], axis=1) * fabric.width / (n - 1)
        z = np.cumsum(np.sin(turn), axis=0) * h + (v / fabric.height) * np.cumsum(slope, axis=1) * h
        y = -np.cumsum(np.cos(turn), axis=0) * h + h
        half = fabric.thickness / 2
        x = u - fabric.width / 2
        faces = [np.stack([x, y + s * np.sin(turn), z + s * np.cos(turn)], axis=-1) for s in (half, -half)]
        return np.concatenate([f.reshape(-1, 3) for f in faces]).astype(np.float32)


class WithJacobian(AnalyticCloth):
    """One that offers derivatives of its shapes at rest, `asked` so often. `wrong`: a factor on them."""

    def __init__(self, points_per_side: int = 41, *, wrong: float = 1.0) -> None:
        super().__init__(points_per_side)
        self.asked, self.wrong = 0, wrong

    def faces_jacobian(self, cases: Sequence[Case], columns: Sequence[Column]) -> list[FacesJacobian]:
        self.asked += 1
        jacobians = []
        for case in cases:
            moves = [move(case, column, column.step) for column in columns]
            sides = [[self._shape(side, 1.0).astype(float) for side in moved.sides] for moved in moves]
            changes = [(high - low) / moved.width for moved, (low, high) in zip(moves, sides, strict=True)]
            points = self._shape(case, 1.0)
            exact = np.ones(len(columns), dtype=bool)
            jacobians.append(FacesJacobian(points, self.wrong * np.array(changes).reshape(-1, *points.shape), exact))
        return jacobians
