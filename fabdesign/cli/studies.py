"""Commands that run a study: searches, sweeps, layouts side by side, the closed loop."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from fabdesign.cli.console import (
    FILE,
    FOLDER,
    SECONDS,
    cluster_option,
    commands,
    force_option,
    json_option,
    print_result,
    tell,
)
from fabdesign.cli.models import effects_option
from fabdesign.cli.progress import SEARCH, described
from fabdesign.units import in_mm

Command = Callable[..., None]
Shown = Callable[[str, float | None], None]


def study_options(seconds: str) -> Callable[[Command], Command]:
    """STUDY, -o, --effects, --cluster, --seconds, --force and --json, in this order. seconds: what they limit."""
    options: tuple[Callable[[Any], Any], ...] = (
        click.argument("study", type=FILE),
        click.option("-o", "--output", type=FOLDER, required=True, help="Folder to write to, or to continue in."),
        effects_option,
        cluster_option,
        click.option("--seconds", type=SECONDS, help=seconds),
        force_option,
        json_option,
    )

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


@commands.command()
@click.option("-o", "--output", type=FOLDER, default=Path("demo"), show_default=True, help="The folder to write to.")
@force_option
@json_option
def demo(output: Path, force: bool, as_json: bool) -> None:
    """Find a layout for an embedded measured cloud.

    The demo writes the layout, its pressures and a report.
    """
    from studies.demo.run import as_json as json_of
    from studies.demo.run import as_text, run_demo
    from studies.layouts.progress import LiveLine

    with LiveLine("demo") as line:
        outcome = run_demo(output, force=force, progress=lambda name, evaluations: line.show(evaluations), say=line.say)
    print_result(json_of(outcome), f"{as_text(outcome)}\nreport: {output / 'report.html'}", as_json)


@commands.command()
@json_option
def prepare(as_json: bool) -> None:
    """Compile the simulator's kernels once on this machine.

    For images and clusters; otherwise that happens at the first use. Two processes may compile side by side.
    """
    from studies.prepare import prepare as compile_all

    seconds = compile_all(tell)
    serves = "for grids up to 41 points a side and designs up to 96 fixed points; others compile at their first use"
    print_result({"seconds": seconds}, f"the simulator is compiled, {seconds:.0f} s, {serves}", as_json)


@commands.command()
@study_options("Time limit of the search, s; by default the study's.")
def optimize(study: Path, output: Path, seconds: float | None, force: bool, as_json: bool) -> None:
    """Find layout and pressures for the target of a STUDY.

    A STUDY is a TOML file. Ctrl-C keeps the best so far; the same command goes on from there.
    """
    from fabdesign.metrics import MANY_BEYOND, told_beyond
    from fabdesign.pressure import poses_in_words
    from studies.layouts.progress import LiveLine
    from studies.layouts.run import run_study
    from studies.layouts.wished import errors_in_words

    with LiveLine(study.stem) as line:
        outcome = run_study(study, output, seconds=seconds, force=force, progress=line.show)
    result = outcome.as_json()
    text = (
        f"{output}: {result['objective_mm']:.3f} mm ({errors_in_words(outcome.study, outcome.errors)}) after "
        f"{result['evaluations']} evaluations, {outcome.search_time}; {result['stop_reason']}"
    )
    outputs = [f"{name}: {', '.join(values)}" for name, values in outcome.outputs.items()]
    after = [result["fewer"]["said"]] if result["fewer"] else []
    after += [outcome.within_said] if outcome.within_said else []
    after += result["robust"]["said"] if result["robust"] else []
    said = [*after, *result["reach"]["said"], *result["way"]["said"]]
    if result["surface_beyond"] >= MANY_BEYOND:
        said.append(told_beyond(result["surface_beyond"]))
    targets = [f"target: {target}" for target in result["targets"]]
    text = "\n".join([*targets, text, *poses_in_words(list(outcome.pressures)), *outputs, *said])
    print_result(result, text, as_json)


@commands.command()
@study_options("Time limit, s; by default the study's, or none.")
def sensitivity(study: Path, output: Path, seconds: float | None, force: bool, as_json: bool) -> None:
    """Say what a shape depends on (Morris, Sobol).

    A STUDY is a TOML file. The same command continues after a stop.
    """
    from studies.sensitivity.report import as_text
    from studies.sensitivity.run import run_sensitivity

    with described(study.stem, interval=SEARCH) as shown:
        result = run_sensitivity(
            study, output, seconds=seconds, force=force, progress=lambda at: shown(str(at), at.done / at.total)
        )
    print_result(result.as_json(), f"{as_text(result)}\nreport: {output / 'report.html'}", as_json)


@commands.command("study")
@study_options("Time limit, s; by default the study's.")
@click.pass_context
def study_of_any_kind(
    context: click.Context, study: Path, output: Path, seconds: float | None, force: bool, as_json: bool
) -> None:
    """Run a STUDY of any kind.

    A STUDY is a TOML file; its kind is optimize, sensitivity, layouts, unseen or loop.
    """
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
    from fabdesign.effort import in_words
    from fabdesign.layouts_file import Cell, read_layouts
    from optimize.evaluations import Evaluations
    from studies.layout_grid.report import as_text
    from studies.layout_grid.run import run_layouts

    with described(study.stem, interval=SEARCH) as shown:
        opening = [in_words]

        def show(cell: Cell, number: int, total: int, evaluations: Evaluations) -> None:
            while opening:  # once the folder is known to be free
                limit = seconds or read_layouts(study).search.limits.seconds
                shown(opening.pop()(limit, f"{total} searches, all within {limit:g} s of search time"), None)
            best = "none yet" if evaluations.best is None else f"{in_mm(evaluations.best.value):.3f} mm"
            line = f"{cell.name}, {number} of {total}: best {best}, {evaluations.elapsed:.0f} s in this search"
            shown(line, min(1.0, (number - 1 + evaluations.share) / total))

        result = run_layouts(study, output, seconds=seconds, force=force, progress=show)
    print_result(result.as_json(), f"{as_text(result)}\nreport: {output / 'report.html'}", as_json)


def _opened(shown: Shown, opening: Callable[[], str]) -> Shown:
    """Return what shows an estimate before the first line, when the folder is known to be free."""
    first = [opening]

    def show(line: str, share: float | None) -> None:
        while first:
            shown(first.pop()(), None)
        shown(line, share)

    return show


def _unseen(study: Path, output: Path, *, seconds: float | None, force: bool, as_json: bool) -> None:
    from fabdesign.unseen_file import read_unseen
    from studies.unseen.report import as_text, without_lines
    from studies.unseen.run import run_unseen, unseen_in_words

    with described(study.stem, interval=SEARCH) as shown:
        show = _opened(shown, lambda: unseen_in_words(read_unseen(study)))
        result = run_unseen(study, output, seconds=seconds, force=force, progress=show)
    print_result(without_lines(result), f"{as_text(result)}\nreport: {output / 'report.html'}", as_json)


@commands.command()
@study_options("Time limit of each search, s; by default the study's.")
def loop(study: Path, output: Path, seconds: float | None, force: bool, as_json: bool) -> None:
    """Choose a design, measure it, improve the model, repeat.

    A STUDY is a TOML file with a target. Measurements come from a virtual rig or from a laboratory. With a laboratory
    the command ends where it needs a measurement set. Run it again when the set is there.
    """
    from fabdesign.loop_file import read_loop
    from studies.loop.report import as_text
    from studies.loop.run import loop_in_words, run_loop

    with described(study.stem) as shown:
        show = _opened(shown, lambda: loop_in_words(read_loop(study), seconds))
        outcome = run_loop(study, output, seconds=seconds, force=force, progress=show)
    print_result(outcome.as_json(), f"{as_text(outcome)}\nreport: {output / 'report.html'}", as_json)
