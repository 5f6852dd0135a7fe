"""The result of a grid of searches, and how its time is shared: a turn for every cell, then turns for those that still
gain."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np

from fabdesign.formats.result_tables import Columns, Tabled, by_name
from fabdesign.formats.schema import Key
from fabdesign.study_files.layouts_file import SIDES, Cell, LayoutsStudy
from fabdesign.units import in_mm
from optimize.search.design_space import DesignSpace
from optimize.search.search_state import StartRow
from optimize.search.starts import Start
from optimize.search.variations import pulling, with_idle
from studies.layout_search.first_layouts import PULL
from studies.layouts import StudyResult

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
        """Return m, of the result; infinite without a result."""
        return self.result.objective if self.result else float("inf")

    @cached_property
    def pulling(self) -> tuple[int, ...]:
        """Return muscles of the result, from 0, that do something in some pose."""
        if self.result is None:
            return ()
        low, high = self.result.study.limits.pressure
        highest = self.result.pressure[:, [muscle.channel for muscle in self.result.design.muscles]].max(axis=0)
        return tuple(np.flatnonzero(highest > low + PULLS * (high - low)).tolist())

    @property
    def sides_used(self) -> str:
        """Return "front", "back" or "both": the faces of the muscles that pull; empty where none does."""
        used = {self.result.design.muscles[k].side for k in self.pulling} if self.result else set()
        return "both" if len(used) == 2 else next(iter(used), "")


@dataclass(frozen=True, eq=False)
class GridResult(Tabled):
    """cells: those that were begun, in order; total: how many there are."""

    study: LayoutsStudy
    cells: tuple[CellResult, ...]
    total: int
    wall_s: float = 0.0  # of all of it, earlier sessions included
    json_keys: ClassVar = (
        ("cells", lambda of: [of._cell(one, one in of.front) for one in of.cells]),
        ("front", lambda of: [one.cell.name for one in of.front]),
        "study.search.objective", ("left", lambda of: of.total - len(of.cells)),
        "interrupted", "wall_s", "study.search.seed",
    )  # fmt: skip

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
        """Return cells that no other beats with as many muscles or fewer, by rising number of muscles."""
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
        for cell in self.to_json()["cells"]:
            poses = {
                name if len(output["values"]) == 1 else f"{name}, pose {pose}": value
                for name, output in cell.get("outputs", {}).items()
                for pose, value in enumerate(output["values"])
            }
            rows.append({name: value for name, value in cell.items() if not isinstance(value, list | dict)} | poses)
        return by_name(rows)

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
    value: Annotated[float, Key(brief=True)] = float("inf")  # m, after the last turn
    beneath: Annotated[float, Key(brief=True)] = float("inf")  # m, of the nearest layout that its seeds were made of


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
    nearest: dict[str, CellResult] = {}  # of each choice of sides
    for f in sorted(beneath, key=lambda f: f.objective):
        nearest.setdefault(f.cell.sides, f)
    seeds: list[Start] = []
    for k, neighbour in enumerate(nearest.values()):
        result = neighbour.result
        assert result is not None
        design = replace(cell.study.design, muscles=result.design.muscles)
        space = DesignSpace(design, cell.study.limits, result.pressure, vary_positions=True)
        best = space, space.encode(design, result.pressure)
        more = with_idle(
            best, count=cell.muscles, sides=SIDES[cell.sides], number=CANDIDATES, seed=cell.study.seed + 7 * k
        )
        seeds += more
        if len(result.design.muscles) < cell.muscles:
            seeds += pulling(more, len(result.design.muscles), PULL)
    return seeds
