"""Training a corrector."""

from pathlib import Path
from typing import Literal

import click

from fabdesign.cli.console import (
    FILE,
    SEED,
    OutputPath,
    cluster_option,
    commands,
    force_option,
    grid_option,
    json_option,
    print_result,
    skip_bad_option,
    tell,
)
from fabdesign.cli.models import effects_option
from fabdesign.cli.progress import described


@commands.command()
@click.argument("sets", nargs=-1, required=True, type=FILE)
@click.option(
    "--network",
    type=click.Choice(["field", "paper"]),
    default="field",
    show_default=True,
    help="field: moves the points of the simulator; paper: the network of Peng et al., which gives an unordered cloud.",
)
@click.option("--hold-out", multiple=True, metavar="DESIGN", help="A design whose trials are not used for training.")
@click.option("--model", type=FILE, help="A model file with the parameters of the motions; by default the data sheet.")
@click.option(
    "--free",
    help="Effects to fit before the training, with the declared parameters and to the same trials, as with "
    "`calibrate --free`; all: the strengths of every effect.",
)
@skip_bad_option
@click.option("--seed", type=SEED, default=0, show_default=True)
@grid_option
@effects_option
@cluster_option
@click.option(
    "-o",
    "--output",
    type=OutputPath(".toml"),
    required=True,
    help="The model to write (TOML); its weights are written beside it.",
)
@force_option
@json_option
def train(
    sets: tuple[Path, ...],
    network: Literal["field", "paper"],
    hold_out: tuple[str, ...],
    model: Path | None,
    free: str | None,
    skip_bad: bool,
    seed: int,
    grid: int | None,
    output: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Train a corrector on measured SETS.

    The corrector learns what the simulator leaves out. The same command continues after a stop.
    """
    from fabdesign import interface
    from studies.training.report import as_text

    with described("training") as shown:
        trained = interface.train(
            sets,
            output,
            network=network,
            hold_out=hold_out,
            model=model,
            free=free.split(",") if free else (),
            skip_bad=skip_bad,
            seed=seed,
            grid=grid,
            force=force,
            progress=shown,
            say=tell,
        )
    weights, skipped = str(output.with_suffix(".safetensors")), [*trained.skipped]
    told = trained.found.as_json() | {"model": str(output), "weights": weights, "skipped": skipped}
    text = [f"{output}: {as_text(trained.found)}", *(f"skipped: {line}" for line in skipped)]
    print_result(told, "\n".join(text), as_json)
