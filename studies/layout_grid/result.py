"""The result of a grid of searches."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fabdesign.formats.result_tables import Columns, Tabled, by_name
from fabdesign.study_files.layouts_file import Cell, LayoutsStudy
from fabdesign.units import in_mm
from studies.layouts.result import StudyResult

PULLS = 0.05  # of the pressure range, over its lowest, from which on a muscle does something
WORDS = {"front": "on the front", "back": "on the back", "both": "on both faces"}


@dataclass(frozen=True, eq=False)
class CellResult:
    """A cell's result, or why there is none."""

    cell: Cell
    result: StudyResult | None
    why: str

    @property
    def objective(self) -> float:
        """m; infinite without a result."""
        return self.result.objective if self.result else float("inf")

    @cached_property
    def pulling(self) -> tuple[int, ...]:
        """Muscles of the result, from 0, that do something in some pose."""
        if self.result is None:
            return ()
        low, high = self.result.study.limits.pressure
        highest = self.result.pressures[:, [muscle.channel for muscle in self.result.design.muscles]].max(axis=0)
        return tuple(np.flatnonzero(highest > low + PULLS * (high - low)).tolist())

    @property
    def sides_used(self) -> str:
        """ "front", "back" or "both": the faces of the muscles that pull; empty where none does."""
        used = {self.result.design.muscles[k].side for k in self.pulling} if self.result else set()
        return "both" if len(used) == 2 else next(iter(used), "")


@dataclass(frozen=True, eq=False)
class GridResult(Tabled):
    """cells: those that were begun, in order; total: how many there are."""

    study: LayoutsStudy
    cells: tuple[CellResult, ...]
    total: int
    wall_s: float = 0.0  # of all of it, earlier sessions included

    @property
    def interrupted(self) -> bool:
        return any(f.result is not None and f.result.interrupted for f in self.cells)

    def nearest(self, cell: Cell) -> CellResult | None:
        """Return the nearest layout that `cell` may have: its own, or that of a cell with fewer muscles or on one
        face."""
        may = [f for f in self.cells if f.result is not None and cell.includes(f.cell)]
        return min(may, key=lambda f: (f.objective, f.cell.muscles), default=None)

    @property
    def front(self) -> list[CellResult]:
        """Cells that no other beats with as many muscles or fewer, by rising number of muscles."""
        kept: list[CellResult] = []
        for f in sorted(self.cells, key=lambda f: (f.cell.muscles, f.objective)):
            if f.result and (not kept or f.objective < kept[-1].objective):
                kept.append(f)
        return kept

    def statements(self, cell: Cell) -> list[str]:
        """Return sentences on where more muscles, or a second face, did not help."""
        this, best = next((f for f in self.cells if f.cell is cell), None), self.nearest(cell)
        if this is None or best is None:
            return []
        statements, count = [], f"{cell.muscles} muscles" if cell.muscles > 1 else "1 muscle"
        if best is not this:
            came = f"its own search came to {in_mm(this.objective):.2f} mm" if this.result else this.why
            statements.append(
                f"{count} {WORDS[cell.sides]} did not help: {best.cell.muscles} {WORDS[best.cell.sides]} are nearer, "
                f"at {in_mm(best.objective):.2f} mm; {came}."
            )
        idle = len(best.result.design.muscles) - len(best.pulling) if best.result else 0
        if idle:
            statements.append(f"{idle} of its {best.cell.muscles} muscles {'is' if idle == 1 else 'are'} idle.")
        if cell.sides == "both" and best.sides_used in ("front", "back"):
            statements.append(f"Only the {best.sides_used} pulls: a second face did not help.")
        return statements

    def columns(self) -> Columns:
        """Return a row a cell: name, muscles, type, sides, the errors [mm] of the nearest layout that it may have, of
        which cell that is, muscles_used, front; and the study's outputs, a column for each pose."""
        rows = []
        for cell in self.as_json()["cells"]:
            poses = {
                name if len(output["values"]) == 1 else f"{name}, pose {pose}": value
                for name, output in cell.get("outputs", {}).items()
                for pose, value in enumerate(output["values"])
            }
            rows.append({name: value for name, value in cell.items() if not isinstance(value, list | dict)} | poses)
        return by_name(rows)

    def as_json(self) -> dict[str, Any]:
        """Return what result.json holds: mm."""
        front = self.front
        return {
            "cells": [self._cell(f, f in front) for f in self.cells],
            "front": [f.cell.name for f in front],
            "objective": self.study.search.objective,
            "left": self.total - len(self.cells),
            "interrupted": self.interrupted,
            "wall_s": self.wall_s,
            "seed": self.study.search.seed,
        }

    def _cell(self, one: CellResult, on_front: bool) -> dict[str, Any]:
        cell, best = one.cell, self.nearest(one.cell)
        entry: dict[str, Any] = {"name": cell.name, "muscles": cell.muscles, "type": cell.type, "sides": cell.sides}
        if one.result is None:
            entry["why_not"] = one.why
        if best is None or best.result is None:
            return entry
        result, searched = best.result, one.result
        entry |= {
            "objective_mm": in_mm(result.objective),
            **result.errors.millimetres(),
            "outputs": result.output_values,
        }
        entry |= {"of": best.cell.name, "sides_used": best.sides_used, "muscles_used": len(best.pulling)}
        entry |= {"said": [*self.statements(cell), *result.reach.sentences], "front": on_front}
        if searched is not None:
            entry |= {"searched_mm": in_mm(searched.objective), "stop_reason": searched.stop_reason}
            entry |= {"evaluations": len(searched.history), "wall_s": searched.wall_s}
        return entry
