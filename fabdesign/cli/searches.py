"""Searches for a layout and its pressures."""

from pathlib import Path

import click

from fabdesign.cli.console import FILE, commands, force_option, json_option, print_result
from fabdesign.cli.studies import study_options


@commands.command()
@click.option("-o", "--output", type=FILE, default=Path("demo"), show_default=True, help="The folder to write to.")
@force_option
@json_option
def demo(output: Path, force: bool, as_json: bool) -> None:
    """Find a layout and pressures for an embedded measured cloud, and write a report."""
    from studies.demo.run import as_json as json_of
    from studies.demo.run import as_text, run_demo
    from studies.layouts.progress import LiveLine

    with LiveLine("demo") as line:
        found = run_demo(output, force=force, progress=lambda name, evaluations: line.show(evaluations), say=line.say)
    print_result(json_of(found), f"{as_text(found)}\nreport: {output / 'report.html'}", as_json)


@commands.command()
@study_options("Time limit of the search, s; by default the study's.")
def optimize(study: Path, output: Path, seconds: float | None, force: bool, as_json: bool) -> None:
    """Find the layout and pressures that come closest to the target of a STUDY (TOML). Ctrl-C keeps the best so far."""
    from fabdesign.metrics import MANY_BEYOND, told_beyond
    from studies.layouts.progress import LiveLine
    from studies.layouts.run import run_study

    with LiveLine(study.stem) as line:
        result = run_study(study, output, seconds=seconds, force=force, progress=line.show).as_json()
    text = (
        f"{output}: {result['objective_mm']:.3f} mm (Chamfer {result['chamfer']:.3f}, noise floor "
        f"{result['chamfer_floor']:.3f}) after {result['evaluations']} evaluations; {result['stop_reason']}"
    )
    after = [result["fewer"]["said"]] if result["fewer"] else []
    after += result["robust"]["said"] if result["robust"] else []
    said = [*after, *result["reach"]["said"], *result["way"]["said"]]
    if result["surface_beyond"] >= MANY_BEYOND:
        said.append(told_beyond(result["surface_beyond"]))
    text = "\n".join([*(f"target: {target}" for target in result["targets"]), text, *said])
    print_result(result, text, as_json)
