"""Models and effects: options of commands that take a model, and the command that lists the effects."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fabdesign.cli.console import FILE, commands, json_option, print_result, tell
from fabdesign.errors import InputError

if TYPE_CHECKING:
    from fabdesign.model import Model


def _register(context: click.Context, parameter: click.Parameter, files: tuple[Path, ...]) -> tuple[Path, ...]:
    from fabdesign.effects import register_file
    from fabdesign.output import always_input

    for file in files:
        register_file(file)
        always_input(file)
    return files


effects_option = click.option(
    "--effects", type=FILE, multiple=True, is_eager=True, expose_value=False, callback=_register,
    help="A Python file with your own effects, which models use by name; the file is executed.",
)  # fmt: skip
without_option = click.option(
    "--without", help="Parts of the model to leave out, separated by commas: rig, sensors, corrector, spread."
)


def parts_of(without: str | None) -> list[str]:
    """Of `--without`."""
    return [] if without is None else without.split(",")


def load_model(path: Path | None, without: str | None = None) -> "Model | None":
    """The model of a file, less the parts named; what was left out, and whether it is stale, goes to standard error."""
    from fabdesign.model_file import usable_model

    if path is None:
        if without is not None:
            raise InputError(f"--without {without}: there is no model; expected it with --model")
        return None
    return usable_model(path, parts_of(without), say=tell)


@commands.command()
@click.argument("name", required=False)
@effects_option
@json_option
def effects(name: str | None, as_json: bool) -> None:
    """List the effects that a model can have.

    With NAME, describe one: parameters, units, priors, what it looks like in data.
    """
    from fabdesign.effects import EFFECTS
    from fabdesign.effects.registry import effect_named, register_installed
    from fabdesign.effects.table import as_json as json_of
    from fabdesign.effects.table import as_text, one_as_text

    register_installed()
    if name is None:
        print_result({"effects": json_of(EFFECTS)}, as_text(EFFECTS), as_json)
        return
    effect = effect_named(name, "effects")
    print_result({"effects": json_of({name: effect})}, one_as_text(effect), as_json)
