"""Motions as sheets, which fits ask for: the mid-surface on the simulator's own grid, and the faces only where clouds
ask."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.forward import Case, ForwardModel

Floats = NDArray[np.floating[Any]]
Face = Literal["both", "front", "back"]


class Sheet(Protocol):
    """One motion."""

    @property
    def middle(self) -> Floats:
        """(T, n, n, 3) m, nodes of the mid-surface by rising v, then rising u."""
        ...

    @property
    def points(self) -> Floats:
        """(T, 2 m, 3) m: front face, then back face, as `ForwardModel.motions` gives them."""
        ...


@dataclass(frozen=True, eq=False)
class SheetWithFaces:
    """A sheet whose faces are made where they are asked for."""

    middle: Floats
    faces: Callable[[], Floats]

    @cached_property
    def points(self) -> Floats:
        return self.faces()


Sheets = Callable[[Sequence[Case], Sequence[NDArray[np.float64]]], Sequence[Sheet]]


def sheets_of(forward: ForwardModel) -> Sheets:
    """Return what gives motions of cases at their `times` [s]: the forward model's own `sheets`. One that has none is
    asked for faces, whose mean is the mid-surface."""
    native: Sheets | None = getattr(forward, "sheets", None)
    return native or (lambda cases, times: [of_faces(points) for points in forward.motions(cases, times)])


def of_faces(points: Floats) -> Sheet:
    """Return the sheet between two faces (T, 2 n^2, 3) m."""
    half = points.shape[1] // 2
    side = round(half**0.5)
    middle = 0.5 * (points[:, :half] + points[:, half:])
    return SheetWithFaces(middle.reshape(len(points), side, side, 3), lambda: points)
