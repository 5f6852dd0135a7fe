"""What commands share that take a model: its parts, effects of one's own, and where it is stale."""

from pathlib import Path
from typing import Any

import click

from fabdesign.cli.console import FILE
from fabdesign.errors import InputError
from fabdesign.model import PARTS, Model
from fabdesign.table import nearest


def _register(context: click.Context, parameter: click.Parameter, files: tuple[Path, ...]) -> tuple[Path, ...]:
    from fabdesign.effects import register_file
    from fabdesign.inputs import always_input

    for file in files:
        register_file(file)
        always_input(file)
    return files


effects_option = click.option(
    "--effects", type=FILE, multiple=True, is_eager=True, expose_value=False, callback=_register,
    help="A Python file with effects of your own, by name in models from then on; it is run.",
)  # fmt: skip
without_option = click.option(
    "--without", help=f"Leave out of the model what belongs to these, by comma: {', '.join(PARTS)}."
)


def load_model(path: Path | None, without: str | None = None) -> Model | None:
    """The model of a file, less the parts named; what was left out, and whether it is stale, goes to standard error."""
    from fabdesign.model_file import read_model

    if path is None:
        if without is not None:
            raise InputError(f"--without {without}: there is no model; expected it with --model")
        return None
    model = read_model(path)
    if model.stale is not None:
        click.echo(f"{path}: {model.stale}", err=True)
    if without is None:
        return model
    parts: list[Any] = [part.strip() for part in without.split(",")]
    for part in parts:
        if part not in PARTS:
            raise InputError(f"--without {part}: expected one of {', '.join(PARTS)}{nearest(part, PARTS)}")
    less = model.without(parts)
    gone = [*(e.name for e in model.effects if e not in less.effects)]
    gone += [name for name in model.parameters if name not in less.parameters]
    gone += ["corrector"] if model.corrector is not None and less.corrector is None else []
    click.echo(f"{path}: without {', '.join(parts)}: {', '.join(gone) or 'nothing'} left out", err=True)
    return less


def require_model(path: Path, without: str | None = None) -> Model:
    """As `load_model`, of a model that must be there."""
    model = load_model(path, without)
    assert model is not None
    return model
