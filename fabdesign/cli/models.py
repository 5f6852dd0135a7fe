"""What commands share that take a model: its parts, effects of one's own, and where it is stale."""

from pathlib import Path

import click

from fabdesign.cli.console import FILE, tell
from fabdesign.errors import InputError
from fabdesign.model import PARTS, Model


def _register(context: click.Context, parameter: click.Parameter, files: tuple[Path, ...]) -> tuple[Path, ...]:
    from fabdesign.effects import register_file
    from fabdesign.inputs import always_input

    for file in files:
        register_file(file)
        always_input(file)
    return files


effects_option = click.option(
    "--effects", type=FILE, multiple=True, is_eager=True, expose_value=False, callback=_register,
    help="A Python file with effects of your own, for use by name in models; the file is run.",
)  # fmt: skip
without_option = click.option(
    "--without", help=f"Parts of the model to leave out, separated by commas: {', '.join(PARTS)}."
)


def parts_of(without: str | None) -> list[str]:
    """Of `--without`."""
    return [] if without is None else without.split(",")


def load_model(path: Path | None, without: str | None = None) -> Model | None:
    """The model of a file, less the parts named; what was left out, and whether it is stale, goes to standard error."""
    from fabdesign.usable_model import usable_model

    if path is None:
        if without is not None:
            raise InputError(f"--without {without}: there is no model; expected it with --model")
        return None
    return usable_model(path, parts_of(without), say=tell)
