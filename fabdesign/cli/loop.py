"""The closed loop: choose, measure, learn, choose again."""

from pathlib import Path

from fabdesign.cli.console import commands, print_result
from fabdesign.cli.progress import described
from fabdesign.cli.studies import study_options


@commands.command()
@study_options("Time limit of each search, s; by default the study's.")
def loop(study: Path, output: Path, seconds: float | None, force: bool, as_json: bool) -> None:
    """Choose a design for the target of a STUDY (TOML), measure it, improve the model, choose again.

    Measurements come from a virtual rig or from a laboratory. With a laboratory the command ends where it needs a
    measurement set. Run it again when the set is there.
    """
    from studies.loop.report import as_text
    from studies.loop.run import run_loop

    with described(study.stem) as shown:
        outcome = run_loop(study, output, seconds=seconds, force=force, progress=shown)
    print_result(outcome.as_json(), f"{as_text(outcome)}\nreport: {output / 'report.html'}", as_json)
