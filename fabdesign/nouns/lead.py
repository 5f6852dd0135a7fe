"""A cloth that was seen, as it leads a motion of the model: springs and dampers along its normals pull at each node."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from scipy.interpolate import CubicSpline

from fabdesign.nouns.array import Array
from fabdesign.nouns.column import SPRINGS, Balance, Column, Course
from fabdesign.nouns.forward import Case

DAMPERS = 2 * SPRINGS**0.5  # 1/s, critical
BEGIN = 0.15  # s after rest, in which they set in


@dataclass(frozen=True, eq=False)
class Lead:
    """The mid-surface of a cloth that was seen. time: (m,) s after rest, rising, two or more; middle: (m, n, n, 3)
    m."""

    time: Array
    middle: Array

    @cached_property
    def _path(self) -> CubicSpline:
        return CubicSpline(self.time, self.middle)

    def ahead(self, times: Array) -> Array:
        """Return (T, n, n, 3) m, where the springs pull to: ahead of the cloth, as far as a node that moves as fast
        loses by the dampers."""
        held = np.clip(times, self.time[0], self.time[-1])
        moves = np.where(held == times, DAMPERS / SPRINGS, 0.0)[:, None, None, None]
        return np.asarray(self._path(held) + moves * self._path(held, 1))

    def pull(self, time: float, middle: Array, velocity: Array, normal: Array) -> Array:
        """Return (n, n, 3) m/s^2, by which a mid-surface is pulled."""
        off = SPRINGS * (self.ahead(np.array([time]))[0] - middle) - DAMPERS * velocity
        return np.asarray(share(time) * (off * normal).sum(axis=-1, keepdims=True) * normal)


class Way(NamedTuple):
    """The instants [s after rest] of a motion's frames, (T,) rising, and what leads it; None: nothing."""

    times: Array
    lead: Lead | None = None


@runtime_checkable
class Balancer(Protocol):
    """An engine that leads motions, and says how frames of them change (docs/model.md)."""

    def led(self, cases: Sequence[Case], ways: Sequence[Way]) -> Sequence[Any]:
        """Return the motions of cases, which have `middle` (T, n, n, 3) m and `points`, led where a way has a lead."""
        ...

    def balances(
        self, cases: Sequence[Case], courses: Sequence[Course], columns: Sequence[Column]
    ) -> list[list[Balance]]:
        """Return how each case's instants change with each column where forces balance with inertia and damping."""
        ...


def share(times: float | Array) -> Array:
    """Return the share of springs and dampers that is there at `times` [s after rest]."""
    return np.clip(np.asarray(times) / BEGIN, 0.0, 1.0)
