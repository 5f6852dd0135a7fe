"""What a model lacks."""

from pathlib import Path

import click

from fabdesign.cli.console import (
    FILE,
    FOLDER,
    GRID,
    SECONDS,
    SEED,
    cluster_option,
    commands,
    force_option,
    json_option,
    print_result,
    tell,
)
from fabdesign.cli.models import effects_option
from fabdesign.cli.progress import described
from fabdesign.units import from_mm


@commands.command()
@click.argument("source", type=FILE, metavar="SET|BENCH")
@click.option("--model", type=FILE, help="A model file: start of the fit, and effects that are already known.")
@click.option(
    "--tolerance",
    type=SECONDS,
    help="Excess error on held-out trials that is accepted: in mm, by default 0.5; for a bench in % of its output, by "
    "default 2.",
)
@click.option("--grid", type=GRID, help="Grid points per side; by default 21, or 41 where 21 are too coarse.")
@click.option("--seed", type=SEED, default=0, show_default=True, help="Seed of the points drawn.")
@effects_option
@cluster_option
@click.option("-o", "--output", type=FOLDER, required=True, help="Folder to write to, or to continue in.")
@force_option
@json_option
def trace(
    source: Path,
    model: Path | None,
    tolerance: float | None,
    grid: int | None,
    seed: int,
    output: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Find which effect the model of measured data lacks.

    The data are a measurement SET or a BENCH. The effects are chosen by model selection. The answer can be that no
    effect is missing, or that none of the known effects explains the data.
    """
    from fabdesign.bench_file import is_bench

    if is_bench(source):
        _trace_bench(source, tolerance, output, force, as_json)
        return
    from fabdesign import interface
    from studies.tracing.words import as_text

    with described("tracing") as shown:
        outcome = interface.trace(
            source,
            output,
            model=model,
            tolerance=None if tolerance is None else from_mm(tolerance),
            grid=grid,
            seed=seed,
            force=force,
            progress=shown,
            say=tell,
        ).found
    print_result(outcome.as_json(), f"{output}: {as_text(outcome)}", as_json)


def _trace_bench(source: Path, tolerance: float | None, output: Path, force: bool, as_json: bool) -> None:
    from studies.tracing.bench import TOLERANCE, trace_bench
    from studies.tracing.bench_report import as_text

    share = TOLERANCE if tolerance is None else tolerance / 100
    with described("tracing") as shown:
        outcome = trace_bench(source, output, tolerance=share, force=force, progress=shown)
    print_result(outcome.as_json(), f"{output}: {as_text(outcome)}", as_json)
