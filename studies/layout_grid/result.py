"""What a grid of searches found."""

from dataclasses import dataclass
from typing import Any

from fabdesign.layouts_file import Cell, LayoutsStudy
from studies.layouts.result import StudyResult


@dataclass(frozen=True, eq=False)
class Found:
    """A cell's result, or why there is none."""

    cell: Cell
    result: StudyResult | None
    why: str

    @property
    def objective(self) -> float:
        """m; infinite without a result."""
        return self.result.objective if self.result else float("inf")


@dataclass(frozen=True, eq=False)
class GridResult:
    """found: of the cells that were begun, in order; total: how many there are."""

    study: LayoutsStudy
    found: tuple[Found, ...]
    total: int

    @property
    def interrupted(self) -> bool:
        return any(f.result is not None and f.result.interrupted for f in self.found)

    @property
    def front(self) -> list[Found]:
        """Cells that no other beats with as many muscles or fewer, by rising number of muscles."""
        kept: list[Found] = []
        for f in sorted(self.found, key=lambda f: (f.cell.muscles, f.objective)):
            if f.result and (not kept or f.objective < kept[-1].objective):
                kept.append(f)
        return kept

    def as_json(self) -> dict[str, Any]:
        """What result.json holds: mm."""
        front = self.front
        return {
            "cells": [_cell(f, f in front) for f in self.found],
            "front": [f.cell.name for f in front],
            "objective": self.study.search.objective,
            "left": self.total - len(self.found),
            "interrupted": self.interrupted,
            "seed": self.study.search.seed,
        }


def _cell(found: Found, on_front: bool) -> dict[str, Any]:
    cell = found.cell
    entry: dict[str, Any] = {"name": cell.name, "muscles": cell.muscles, "type": cell.type, "sides": cell.sides}
    if found.result is None:
        return entry | {"why_not": found.why}
    result = found.result.as_json()
    keys = ("objective_mm", "chamfer", "chamfer_floor", "surface_rms", "surface_floor", "evaluations", "wall_s")
    said = found.result.reach.sentences
    return entry | {k: result[k] for k in keys} | {
        "stop_reason": result["stop_reason"], "said": said, "front": on_front
    }  # fmt: skip
