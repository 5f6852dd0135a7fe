"""A grid of searches for one target, each in a folder of its own, and their front."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from fabdesign.errors import InputError, SimulationError
from fabdesign.forward import ForwardModel
from fabdesign.layouts_file import Cell, LayoutsStudy, read_layouts
from fabdesign.output import WorkFolder, work_folder
from optimize.evaluations import Evaluations
from studies.layout_grid.report import write_report
from studies.layout_grid.result import Found, GridResult
from studies.layouts.begin import first_starts
from studies.layouts.run import run_study
from studies.layouts.target import load_target

CELLS = "cells"  # the folder of the searches' folders


def run_layouts(
    study: LayoutsStudy | Path | str,
    out: Path | str,
    *,
    forward: ForwardModel | None = None,
    coarse: ForwardModel | None = None,
    seconds: float | None = None,
    force: bool = False,
    progress: Callable[[Cell, int, int, Evaluations], None] = lambda *_: None,
) -> GridResult:
    """Search every cell and write `result.json`, `report.html` and `cells/NAME`, what `optimize` writes, into `out`.

    Each cell has its share of the seconds (of the study, or `seconds`). The same study goes on in its folder: finished
    cells are not searched again, the one that was under way goes on, and with more seconds all do. Ctrl-C ends with
    what is there. A cell for which no layout keeps the limits is told, not searched. progress: of a cell, its number,
    how many there are, and how its search stands.
    Raises InputError like `run_study`, SimulationError where no cell has a result.
    """
    inputs = [] if isinstance(study, LayoutsStudy) else [study]
    study = study if isinstance(study, LayoutsStudy) else read_layouts(study)
    if seconds is not None:
        limits = replace(study.search.limits, seconds=seconds)
        study = replace(study, search=replace(study.search, limits=limits))
    for target in study.search.targets:
        load_target(target, study.search.design, seed=study.search.seed)  # sound, or said at once
        inputs.append(target.file)
    with work_folder(out, made_by="layouts", force=force, inputs=inputs) as work:
        result = _searched(work, study, forward, coarse, progress)
        if work.anew and result.interrupted:
            work.complete = False
        with work.adding() as files:
            write_report(result, files)
    return result


def _searched(
    work: WorkFolder,
    study: LayoutsStudy,
    forward: ForwardModel | None,
    coarse: ForwardModel | None,
    progress: Callable[[Cell, int, int, Evaluations], None],
) -> GridResult:
    cells, found = [*study.cells], []
    for number, cell in enumerate(cells, start=1):
        try:
            first_starts(cell.study)
        except InputError as error:
            found.append(Found(cell, None, str(error)))
            continue

        def told(evaluations: Evaluations, cell: Cell = cell, number: int = number) -> None:
            progress(cell, number, len(cells), evaluations)

        try:
            result = run_study(
                cell.study, work.folder / CELLS / cell.name, forward=forward, coarse=coarse, progress=told
            )
        except SimulationError as error:
            found.append(Found(cell, None, str(error)))
            continue
        found.append(Found(cell, result, ""))
        if result.interrupted:
            break
    if not any(f.result for f in found):
        raise SimulationError(f"{study.search.name}: no cell has a result; the first: {found[0].why}")
    return GridResult(study, tuple(found), len(cells))
