"""A grid of searches for one target, each in a folder of its own, and their front."""

from collections.abc import Callable
from pathlib import Path
from typing import Unpack

from fabdesign.errors import InputError, SimulationError
from fabdesign.formats.json_file import read_json, write_json
from fabdesign.formats.toml_file import file_stem
from fabdesign.output import WorkFolder
from fabdesign.runtime import working_time
from fabdesign.runtime.store import read_kept
from fabdesign.study_files.layouts_file import Cell, LayoutsStudy
from optimize.search.evaluations import Evaluations
from optimize.search.search_state import as_row, of_row
from optimize.search.starts import Start
from studies.layout_grid.report import write_report
from studies.layout_grid.turns import CellResult, CellTurns, GridResult, best_beneath, next_turn, recent_gain, seeds_of
from studies.layout_search.first_layouts import first_starts
from studies.layout_search.target import load_target
from studies.layouts import Verification, run_study
from studies.study import Simulated, StudyRun

CELLS = "cells"  # the folder of the searches' folders
TURNS = "turns.json"  # how the time was shared, by which a grid goes on
FIRST = 0.6  # of the seconds, for the first turns of all cells
FOLLOWED = 0.12  # of the seconds, at the end, for the motions that lead to the results
FIRST_FOLLOWED = 16.0  # times what the end of a turn takes: motions of seconds, and what they need is to be compiled
PAGE = 0.5  # s a cell, for the page
FURTHER = 0.05  # of the seconds: a further turn
WORTH_A_TURN = 2.0  # times what an end takes, for a turn to be worth it
END = 0.25  # of a turn, that its end is thought to take before one was measured

Progress = Callable[[Cell, int, int, Evaluations], None]


def run_layouts(
    study: LayoutsStudy | Path | str, out: Path | str, *, progress: Progress = lambda *_: None, **how: Unpack[Simulated]
) -> GridResult:
    """Search every cell and write `result.json`, `report.html` and `cells/NAME`, what `optimize` writes, into `out`.

    A cell begins at what the cells that it includes have found, so that more muscles and a second face are no worse.
    Every cell has a turn, with an even share of 60 % of the seconds (of the study, or `seconds`); the rest goes to
    those that gain by it, while any does, and to the motions that lead to the results on the front. Nothing begins
    that is not thought to end within the seconds.

    The same study goes on in its folder: finished cells are not searched again, the one that was under way goes on,
    and with more seconds those that gain do. Ctrl-C ends with what is there. A cell for which no layout keeps the
    limits is told, not searched. progress: of a cell, its number, how many there are, and how its search stands.
    Raises InputError like `run_study`, SimulationError where no cell has a result.
    """
    run = StudyRun.of(study, LayoutsStudy.read, how)
    search = run.study.search
    for target in search.targets:
        load_target(target, search.design, seed=search.seed)  # sound, or said at once
    with run.folder(out, "layouts", [target.file for target in search.targets if target.points is None]) as work:
        result = GridSearch(work, run.study, how, progress).searched()
        if work.anew and result.interrupted:
            work.complete = False
        with work.adding() as files:
            write_report(result, files)
    return result


class GridSearch:
    """The turns of a grid in its folder."""

    def __init__(self, work: WorkFolder, study: LayoutsStudy, how: Simulated, progress: Progress) -> None:
        self._work, self._study, self._how, self._progress = work, study, how, progress
        self._cells = [*study.cells]
        self._drawn: dict[str, list[Start]] = {}  # by the cell's name, as are its turns and its result
        self._results: dict[str, CellResult] = {}
        self._turns, spent = turns_kept(work.folder / TURNS)
        self._began = working_time.seconds() - spent
        self._end = 0.0  # s that a turn took beyond its search
        self._longest = 0.0  # s that it took to follow the motions to a result

    def searched(self) -> GridResult:
        for cell in self._cells:
            self._first_turn(cell)
            if self._result().interrupted:
                return self._result()
        result = self._result()
        if not any(f.result for f in result.cells):
            raise SimulationError(f"{self._study.search.name}: no cell has a result; the first: {result.cells[0].why}")
        while not result.interrupted and (further := self._time_for_another()):
            chosen = next_turn(result, self._turns, further)
            if chosen is None:
                break
            self._further_turn(chosen, further)
            result = self._result()
        return result if result.interrupted else self._followed(result)

    def _followed(self, result: GridResult) -> GridResult:
        """Return the result with the motions that lead to what is on the front, the nearest first, while there is time
        for another."""
        while ahead := [f for f in reversed(result.front) if f.result is not None and f.result.loading_path is None]:
            begin = working_time.seconds()
            if self._spent + self._to_follow > self._limit:
                break
            self._run(ahead[0].cell, verification="motion")
            self._longest = max(self._longest, working_time.seconds() - begin)
            result = self._result()
        return result

    @property
    def _limit(self) -> float:
        """Return s for all but the page."""
        return self._study.search.limits.seconds - PAGE * len(self._cells)

    @property
    def _to_follow(self) -> float:
        """Return s that it is thought to take to follow the motions to one result."""
        return self._longest or FIRST_FOLLOWED * self._end

    @property
    def _spent(self) -> float:
        return working_time.seconds() - self._began

    def _result(self) -> GridResult:
        return GridResult(self._study, tuple(self._results.values()), len(self._cells), self._spent)

    def _time_for_another(self) -> float:
        """Return the seconds of search in another turn, 0 where there is no time."""
        seconds = self._study.search.limits.seconds
        until = self._limit - max(FOLLOWED * seconds, self._to_follow)
        remaining, turn = until - self._spent - self._end, max(FURTHER * seconds, WORTH_A_TURN * self._end)
        return min(turn, remaining) if remaining > WORTH_A_TURN * self._end and remaining > 0.01 * seconds else 0.0

    def _first_turn(self, cell: Cell) -> None:
        try:
            self._drawn[cell.name] = first_starts(cell.study)
        except InputError as error:
            self._results[cell.name] = CellResult(cell, None, str(error))
            return
        if cell.name not in self._turns:
            share, result = FIRST * self._study.search.limits.seconds / len(self._cells), self._result()
            self._turns[cell.name] = CellTurns(
                seeds=[*map(as_row, seeds_of(cell, result.cells))],
                seconds=max(share / 4, share - (self._end or END * share)),
                beneath=best_beneath(cell, result),
            )
            self._keep()
        try:
            searched = self._run(cell)
        except SimulationError as error:
            self._results[cell.name] = CellResult(cell, None, str(error))
            return
        turns = self._turns[cell.name]
        if not turns.turns and not self._result().interrupted:
            turns.turns, turns.value, turns.gained = 1, searched.objective, recent_gain(searched)
        self._keep()

    def _further_turn(self, chosen: CellResult, seconds: float) -> None:
        """Search on from where it stands; or anew from what its neighbours have found since."""
        cell, turns, result = chosen.cell, self._turns[chosen.cell.name], self._result()
        beneath = best_beneath(cell, result)
        anew = chosen.objective - beneath > 0 and beneath < turns.beneath
        if anew:
            seeds = [*map(as_row, seeds_of(cell, result.cells))]
            turns.seeds, turns.drawn, turns.seconds, turns.beneath = seeds, False, 0.0, beneath
        turns.seconds += seconds
        reached = self._run(cell, force=anew).objective
        turns.turns += 1
        turns.gained, turns.value = max(0.0, turns.value - reached), reached
        self._keep()

    def _run(self, cell: Cell, *, verification: Verification = "at rest", force: bool = False) -> CellResult:
        """Return the cell's new result, which takes the place of the one before."""
        last, turns = working_time.seconds(), self._turns[cell.name]

        def heard(evaluations: Evaluations) -> None:
            nonlocal last
            last = working_time.seconds()
            if verification != "motion":  # which is no search
                self._progress(cell, self._cells.index(cell) + 1, len(self._cells), evaluations)

        study, drawn = cell.study, self._drawn[cell.name]
        seeds = [of_row(row, study.design, study.limits) for row in turns.seeds]
        result = run_study(
            study,
            self._work.folder / CELLS / file_stem(cell.name),
            forward=self._how.get("forward"),
            coarse=self._how.get("coarse"),
            seconds=turns.seconds,
            starts=[*seeds, *(drawn if turns.drawn else [])],
            force=force,
            verification=verification,
            progress=heard,
        )
        if verification == "at rest":
            self._end = max(self._end, working_time.seconds() - last)
        self._results[cell.name] = CellResult(cell, result, "")
        return self._results[cell.name]

    def _keep(self) -> None:
        with self._work.adding() as files:
            write_json(files / TURNS, {"spent": self._spent, "cells": self._turns})


def turns_kept(file: Path) -> tuple[dict[str, CellTurns], float]:
    """Return the turns of each cell and the s spent; none before the first turn."""

    def read(file: Path) -> tuple[dict[str, CellTurns], float]:
        state = read_json(file)
        return {name: CellTurns(**row) for name, row in state["cells"].items()}, float(state["spent"])

    return read_kept(file, read, "how the time was shared") or ({}, 0.0)
