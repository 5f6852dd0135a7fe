"""Studies that are many computations: what matters, layouts side by side, and studies of any kind."""

from pathlib import Path
from typing import Any

import click

from fabdesign.cli.console import commands, print_result
from fabdesign.cli.studies import study_options


@commands.command()
@study_options("Time limit, s; by default the study's, or none.")
def sensitivity(study: Path, output: Path, seconds: float | None, force: bool, as_json: bool) -> None:
    """Say what a shape depends on: Morris screening and Sobol indices of a STUDY (TOML). Continues after a stop."""
    from studies.layouts.progress import LiveLine
    from studies.sensitivity.report import as_text
    from studies.sensitivity.run import run_sensitivity

    with LiveLine(study.stem) as line:
        result = run_sensitivity(study, output, seconds=seconds, force=force, progress=lambda at: line.say(str(at)))
    print_result(result.as_json(), f"{as_text(result)}\nreport: {output / 'report.html'}", as_json)


@commands.command("study")
@study_options("Time limit, s; by default the study's.")
@click.pass_context
def study_of_any_kind(
    context: click.Context, study: Path, output: Path, seconds: float | None, force: bool, as_json: bool
) -> None:
    """Run a STUDY (TOML) of any kind: optimize, sensitivity, layouts, unseen, loop."""
    from fabdesign.study_file import read_kind

    kind = read_kind(study)
    options: dict[str, Any] = {"seconds": seconds, "force": force, "as_json": as_json}
    if kind == "layouts":
        _layouts(study, output, **options)
    elif kind == "unseen":
        _unseen(study, output, **options)
    else:
        context.invoke(commands.commands[kind], study=study, output=output, **options)


def _layouts(study: Path, output: Path, *, seconds: float | None, force: bool, as_json: bool) -> None:
    from fabdesign.layouts_file import Cell
    from optimize.evaluations import Evaluations
    from studies.layout_grid.report import as_text
    from studies.layout_grid.run import run_layouts
    from studies.layouts.progress import LiveLine

    with LiveLine(study.stem) as line:

        def show(cell: Cell, number: int, total: int, evaluations: Evaluations) -> None:
            best = "none yet" if evaluations.best is None else f"{1e3 * evaluations.best.value:.3f} mm"
            line.say(f"{cell.name}, {number} of {total}: best {best}, {evaluations.elapsed:.0f} s in this cell")

        result = run_layouts(study, output, seconds=seconds, force=force, progress=show)
    print_result(result.as_json(), f"{as_text(result)}\nreport: {output / 'report.html'}", as_json)


def _unseen(study: Path, output: Path, *, seconds: float | None, force: bool, as_json: bool) -> None:
    from studies.layouts.progress import LiveLine
    from studies.unseen.report import as_text, without_lines
    from studies.unseen.run import run_unseen

    with LiveLine(study.stem) as line:
        result = run_unseen(study, output, seconds=seconds, force=force, progress=line.say)
    print_result(without_lines(result), f"{as_text(result)}\nreport: {output / 'report.html'}", as_json)
