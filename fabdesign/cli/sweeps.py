"""Studies that are many computations: what matters, and studies of any kind."""

from pathlib import Path

import click

from fabdesign.cli.console import FILE, SECONDS, commands, force_option, json_option, print_result
from fabdesign.cli.models import effects_option


@commands.command()
@click.argument("study", type=FILE)
@click.option("-o", "--output", type=FILE, required=True, help="The folder to write to, or to go on in.")
@effects_option
@click.option("--seconds", type=SECONDS, help="Of computing; by default the study's, or all that it takes.")
@force_option
@json_option
def sensitivity(study: Path, output: Path, seconds: float | None, force: bool, as_json: bool) -> None:
    """What a shape depends on: Morris screening and Sobol indices of a STUDY (TOML). Goes on where it was stopped."""
    from studies.layouts.progress import LiveLine
    from studies.sensitivity.report import as_text
    from studies.sensitivity.run import run_sensitivity

    with LiveLine(study.stem) as line:
        result = run_sensitivity(study, output, seconds=seconds, force=force, progress=lambda at: line.say(str(at)))
    print_result(result.as_json(), f"{as_text(result)}\nreport: {output / 'report.html'}", as_json)
