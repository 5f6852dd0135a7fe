"""The best that a search has come to, what is as near, and the nearest of each number of muscles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fabdesign.nouns.forward import ForwardModel
from optimize.search.design_space import Vector
from optimize.search.objective import Poses

MARGIN = 0.02  # of the best value: so near is as near


@dataclass(frozen=True)
class Stage:
    """The best `keep` of what came before go on for up to `rounds` rounds each, on this forward model.

    No round begins after the share `until` of the seconds that were left when the restart began, so that a slow
    machine gets to the last stage too.
    slopes: a cheaper model of the same shape that derivatives are asked of, or finite differences taken on where it
    offers none; `forward` itself by default. at_rest: late frames are valued by shapes at rest.
    """

    name: str
    forward: ForwardModel
    keep: int
    rounds: int
    vary_positions: bool = False
    until: float = 1.0
    slopes: ForwardModel | None = None
    at_rest: bool = False

    def values_as(self, other: "Stage") -> bool:
        """Return whether values of both can be compared."""
        return self.forward is other.forward and self.at_rest == other.at_rest


@dataclass(frozen=True, eq=False)
class Best:
    start: int
    x: Vector
    value: float  # m, on the forward model of the stage
    stage: int

    def as_row(self) -> list[Any]:
        """Return a row for a checkpoint."""
        return [self.start, self.x.tolist(), self.value, self.stage]

    @staticmethod
    def of_row(row: Sequence[Any]) -> "Best":
        start, x, value, stage = row
        return Best(start, np.array(x), value, stage)


class BestSoFar:
    """The best on the models of `stages`; of different models a later stage's knows better, whatever it says.

    rivals: of each start, the nearest on the last stage's model, while within `margin` of the best, a share of its
    value. by_count: number of muscles -> m, the nearest on that model.
    """

    def __init__(self, stages: Sequence[Stage]) -> None:
        self._stages = stages
        self.best: Best | None = None
        self.shape: Poses | None = None  # of the best, where it was evaluated in this session
        self.rivals: dict[int, Best] = {}
        self.by_count: dict[int, float] = {}
        self.margin = MARGIN

    def is_full(self, reached: Best) -> bool:
        """Return whether its value is of the last stage's model."""
        return self._stages[reached.stage].values_as(self._stages[-1])

    def count(self, reached: Best, muscles: int) -> None:
        if self.is_full(reached):
            self.by_count[muscles] = min(reached.value, self.by_count.get(muscles, np.inf))

    def note(self, rival: Best, shape: Poses) -> None:
        """Keep it as the best, and among those that are as near."""
        stage, best = self._stages[rival.stage], self.best
        alike = best is not None and self._stages[best.stage].values_as(stage)
        if best is None or (rival.value < best.value if alike else rival.stage > best.stage):
            self.best, self.shape = rival, shape
        if self.is_full(rival):
            known = self.rivals.get(rival.start)
            if known is None or rival.value < known.value:
                self.rivals[rival.start] = rival
            self.rivals = {kept.start: kept for kept in self.within(self.margin)}

    def within(self, margin: float) -> list[Best]:
        """Return the rivals within a share of the best value, the nearest first; none of a best that is not of the last
        stage's model."""
        if self.best is None or not self.is_full(self.best):
            return []
        most = (1 + margin) * self.best.value
        return sorted((rival for rival in self.rivals.values() if rival.value <= most), key=lambda rival: rival.value)

    @property
    def front(self) -> list[tuple[int, float]]:
        """Return numbers of muscles and the nearest value [m] of each on the last stage's model: those that come nearer
        than all smaller numbers."""
        front: list[tuple[int, float]] = []
        for count, value in sorted(self.by_count.items()):
            if not front or value < front[-1][1]:
                front.append((count, value))
        return front

    def rows(self) -> dict[str, Any]:
        """Return rows for a checkpoint."""
        return {
            "best": self.best and self.best.as_row(),
            "rivals": [rival.as_row() for rival in self.rivals.values()],
            "by_count": [*self.by_count.items()],
        }

    def take(self, rows: Mapping[str, Any]) -> None:
        """Take what `rows` gave."""
        self.best = rows["best"] and Best.of_row(rows["best"])
        self.rivals = {row[0]: Best.of_row(row) for row in rows.get("rivals", [])}
        self.by_count = dict(map(tuple, rows.get("by_count", [])))
