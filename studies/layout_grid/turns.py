"""How the time of a grid is shared: a turn for every cell, then turns for those that still gain."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from fabdesign.study_files.layouts_file import SIDES, Cell
from optimize.search.design_space import DesignSpace
from optimize.search.search_state import StartRow
from optimize.search.starts import Start
from optimize.search.variations import pulling, with_idle
from studies.layout_grid.result import CellResult, GridResult
from studies.layout_search.first_layouts import PULL, limits_of

FIRST = 0.6  # of the seconds, for the first turns of all cells
FOLLOWED = 0.12  # of the seconds, at the end, for the motions that lead to the results
FIRST_FOLLOWED = 16.0  # times what the end of a turn takes: motions of seconds, and what they need is to be compiled
PAGE = 0.5  # s a cell, for the page
FURTHER = 0.05  # of the seconds: a further turn
WORTH_A_TURN = 2.0  # times what an end takes, for a turn to be worth it
GAINS = 0.005  # of the value: less is no gain
ENDED = ("converged", "at the floor", "ended", "nothing gained", "the limit of", "every design")


@dataclass
class CellTurns:
    """The turns of one cell. seconds: of search, all turns together, as `run_study` takes them. gained: m, in the last
    turn. seeds: what its search began with besides its own draws (drawn: whether there were any)."""

    seeds: list[StartRow] = field(default_factory=list)
    drawn: bool = True
    seconds: float = 0.0
    turns: int = 0
    gained: float = 0.0
    value: float = float("inf")  # m, after the last turn
    beneath: float = float("inf")  # m, of the nearest layout that its seeds were made of

    def as_row(self) -> dict[str, Any]:
        """Return a row for JSON: infinite values are absent."""
        return {name: value for name, value in vars(self).items() if value != float("inf")}


def best_beneath(cell: Cell, result: GridResult) -> float:
    """Return the error [m] of the nearest layout of the other cells that `cell` includes."""
    return min((f.objective for f in result.cells if f.cell is not cell and cell.includes(f.cell)), default=np.inf)


def recent_gain(cell: CellResult) -> float:
    """Return how far [m] the full model's best fell in the latter half of the search; all of it where it came only
    then."""
    assert cell.result is not None
    entries = [entry for entry in cell.result.history if not entry.diverged]
    last = [(e.seconds, e.objective) for e in entries if e.stage == "full model"]
    if not last:
        return cell.objective
    half = cell.result.wall_s / 2
    before = [value for seconds, value in last if seconds <= half] or [last[0][1]]
    return max(0.0, min(before) - min(value for _, value in last))


def next_turn(result: GridResult, turns: dict[str, CellTurns], seconds: float) -> CellResult | None:
    """Return the cell that promises most in a turn of so many seconds; None where none does.

    A cell promises what it gained a second in its turn before, or, where its neighbours have got ahead of it, what
    it lies behind them.
    """
    promised = []
    for f in result.cells:
        taken = turns.get(f.cell.name)
        if f.result is None or taken is None:
            continue
        behind = f.objective - best_beneath(f.cell, result)
        if behind > GAINS * f.objective and best_beneath(f.cell, result) < (1 - GAINS) * taken.beneath:
            promised.append((behind, f))
        elif not f.result.stop_reason.startswith(ENDED) and taken.gained > GAINS * f.objective:
            per_second = taken.gained / max(taken.seconds / max(1, taken.turns), 1e-9)
            promised.append((per_second * seconds - max(0.0, behind), f))
    best = max(promised, key=lambda pair: pair[0], default=None)
    return best[1] if best is not None and best[0] > 0 else None


CANDIDATES = 12  # of further muscles, drawn for each neighbour's layout: idle, and again at a share of the pressure


def seeds_of(cell: Cell, results: Sequence[CellResult]) -> list[Start]:
    """Return the layouts of the cells that this one includes, nearest first, and with idle muscles up to the cell's
    number.

    Where a layout without a change has the cell's number of muscles already, it is a seed as it is.
    """
    beneath = [f for f in results if f.result is not None and f.cell is not cell and cell.includes(f.cell)]
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
    """Return the nearest layout of each choice of sides."""
    best: dict[str, CellResult] = {}
    for f in sorted(beneath, key=lambda f: f.objective):
        best.setdefault(f.cell.sides, f)
    return [*best.values()]


def _on_cloth_of(cell: Cell, muscles: Sequence[Muscle]) -> Design:
    return replace(cell.study.design, muscles=tuple(muscles))
