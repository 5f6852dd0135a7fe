"""Training a corrector."""

from pathlib import Path
from typing import Literal

import click

from fabdesign.cli.console import (
    FILE,
    SEED,
    commands,
    force_option,
    grid_option,
    json_option,
    points_per_side,
    print_result,
    skip_bad_option,
)
from fabdesign.cli.machines import cluster_option
from fabdesign.cli.models import effects_option, load_model
from fabdesign.cli.progress import described


@commands.command()
@click.argument("sets", nargs=-1, required=True, type=FILE)
@click.option(
    "--network",
    type=click.Choice(["field", "paper"]),
    default="field",
    show_default=True,
    help="field: moves the simulator's points; paper: the seed paper's, which gives an unordered cloud.",
)
@click.option("--hold-out", multiple=True, metavar="DESIGN", help="A design whose trials are not learned from.")
@click.option("--model", type=FILE, help="Whose parameters the motions have; the data sheet's without it.")
@skip_bad_option
@click.option("--seed", type=SEED, default=0, show_default=True)
@grid_option
@effects_option
@cluster_option
@click.option("-o", "--output", type=FILE, required=True, help="The model to write (TOML); its weights lie beside it.")
@force_option
@json_option
def train(
    sets: tuple[Path, ...],
    network: Literal["field", "paper"],
    hold_out: tuple[str, ...],
    model: Path | None,
    skip_bad: bool,
    seed: int,
    grid: int | None,
    output: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Train a corrector on the measured SETS: what the simulator leaves out. Stopped, the same command goes on."""
    if network == "paper":
        import corrector.paper_training  # noqa: F401 loads PyTorch: without it nothing is begun
    from fabdesign.measurement_set import read_set
    from fabdesign.output import new_files
    from studies.bad_data import sound_trials
    from studies.judged_search import GRID as JUDGING
    from studies.training.report import as_text
    from studies.training.train import train as train_on

    base = load_model(model)
    checked = [sound_trials(read_set(path), skip_bad=skip_bad) for path in sets]
    measured, skipped = [found for found, _ in checked], [line for _, lines in checked for line in lines]
    inputs = [file for file in (*sets, model) if file is not None]
    beside = output.with_suffix(".safetensors").name
    with new_files(output, companions=[beside], force=force, inputs=inputs) as unfinished:
        from sim import Simulator

        with described("training") as shown:
            result = train_on(
                measured,
                Simulator(points_per_side(grid, base)),
                unfinished,
                goes_to=output,
                base=base,
                network=network,
                hold_out=hold_out,
                seed=seed,
                force=force,
                coarse=Simulator(JUDGING),
                progress=lambda what, done, total: shown(f"{what} {done} of {total}", done / total),
            )
    found = result.as_json() | {"model": str(output), "weights": str(output.with_name(beside)), "skipped": skipped}
    print_result(found, "\n".join([f"{output}: {as_text(result)}", *(f"skipped: {s}" for s in skipped)]), as_json)
