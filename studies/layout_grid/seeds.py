"""Where the search of a cell begins besides its own draws: at what the cells that it includes have found."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from fabdesign.design import Design
from fabdesign.layouts_file import SIDES, Cell
from fabdesign.muscle import Muscle
from optimize.additions import pulling, with_idle
from optimize.design_space import DesignSpace
from optimize.starts import Start
from studies.layout_grid.result import Found
from studies.layouts.begin import limits_of

CANDIDATES = 12  # of further muscles, drawn for each neighbour's layout: idle, and again at a share of the pressure
SHARE = 0.4  # of the pressure range: past the threshold of a braided muscle, so that a pull shows


def seeds_of(cell: Cell, found: Sequence[Found]) -> list[Start]:
    """Of the cells that this one includes, nearest first: their layouts, and with idle muscles up to the cell's number.

    Where a layout without a change has the cell's number of muscles already, it is a seed as it is.
    """
    beneath = [f for f in found if f.result is not None and f.cell is not cell and cell.includes(f.cell)]
    seeds: list[Start] = []
    for k, neighbour in enumerate(_nearest(beneath)):
        result = neighbour.result
        assert result is not None
        space = DesignSpace(_on_cloth_of(cell, result.design.muscles), limits_of(cell.study), result.pressures)
        start = replace(space, vary_positions=True)
        best = start, start.encode(space.design, result.pressures)
        more = with_idle(
            best, count=cell.muscles, sides=SIDES[cell.sides], number=CANDIDATES, seed=cell.study.seed + 7 * k
        )
        seeds += more
        if len(result.design.muscles) < cell.muscles:
            seeds += pulling(more, len(result.design.muscles), SHARE)
    return seeds


def _nearest(beneath: Sequence[Found]) -> list[Found]:
    """Of each choice of sides the nearest layout, and of all others none."""
    best: dict[str, Found] = {}
    for f in sorted(beneath, key=lambda f: f.objective):
        best.setdefault(f.cell.sides, f)
    return [*best.values()]


def _on_cloth_of(cell: Cell, muscles: Sequence[Muscle]) -> Design:
    return replace(cell.study.design, muscles=tuple(muscles))


def as_rows(starts: Sequence[Start]) -> list[dict[str, Any]]:
    """For JSON: muscles, and (poses, channels) pressures in Pa."""
    rows = []
    for space, x in starts:
        design, pressures = space.decode(x)
        rows.append({"muscles": [asdict(muscle) for muscle in design.muscles], "pressures": pressures.tolist()})
    return rows


def of_rows(rows: Sequence[dict[str, Any]], cell: Cell) -> list[Start]:
    """What `as_rows` wrote."""
    starts = []
    for row in rows:
        muscles = [
            Muscle(**{**muscle, "path": tuple((float(u), float(v)) for u, v in muscle["path"])})
            for muscle in row["muscles"]
        ]
        design, pressures = _on_cloth_of(cell, muscles), np.array(row["pressures"], dtype=float)
        space = DesignSpace(design, limits_of(cell.study), pressures, vary_positions=True)
        starts.append((space, space.encode(design, pressures)))
    return starts
