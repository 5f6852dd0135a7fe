"""Where the search of a cell begins besides its own draws: at what the cells that it includes have found."""

from collections.abc import Sequence
from dataclasses import replace

from fabdesign.design import Design
from fabdesign.layouts_file import SIDES, Cell
from fabdesign.muscle import Muscle
from optimize.additions import pulling, with_idle
from optimize.design_space import DesignSpace
from optimize.starts import Start
from studies.layout_grid.result import CellResult
from studies.layouts.begin import PULL, limits_of

CANDIDATES = 12  # of further muscles, drawn for each neighbour's layout: idle, and again at a share of the pressure


def seeds_of(cell: Cell, found: Sequence[CellResult]) -> list[Start]:
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
            seeds += pulling(more, len(result.design.muscles), PULL)
    return seeds


def _nearest(beneath: Sequence[CellResult]) -> list[CellResult]:
    """Of each choice of sides the nearest layout, and of all others none."""
    best: dict[str, CellResult] = {}
    for f in sorted(beneath, key=lambda f: f.objective):
        best.setdefault(f.cell.sides, f)
    return [*best.values()]


def _on_cloth_of(cell: Cell, muscles: Sequence[Muscle]) -> Design:
    return replace(cell.study.design, muscles=tuple(muscles))
