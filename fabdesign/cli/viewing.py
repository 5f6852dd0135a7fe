"""Look at motions, measured clouds and predictions."""

from pathlib import Path

import click

from fabdesign.cli.console import (
    FILE,
    FINITE,
    commands,
    force_option,
    grid_option,
    json_option,
    points_per_side,
    print_result,
)
from fabdesign.cli.models import effects_option, load_model, without_option
from fabdesign.errors import InputError


@commands.command()
@click.argument("files", nargs=-1, required=True, type=FILE)
@click.option("--model", type=FILE, help="A model file: each trial's prediction beside it.")
@click.option("--design", type=FILE, help="Of a lone trial that is to be predicted; a set names its own.")
@click.option("--trial", help="Of a set, by name; its first by default.")
@without_option
@effects_option
@click.option("--time", "times", multiple=True, type=FINITE, help="s, an instant of a PNG; may come several times.")
@grid_option
@click.option("-o", "--output", type=FILE, required=True, help="NAME.html (turns and plays), NAME.png or NAME.gif.")
@force_option
@json_option
def view(
    files: tuple[Path, ...],
    model: Path | None,
    without: str | None,
    design: Path | None,
    trial: str | None,
    times: tuple[float, ...],
    grid: int | None,
    output: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Show FILES side by side: motions, measurement sets, trials, clouds and meshes, with a MODEL predictions too."""
    from fabdesign.output import new_file
    from studies.view.items import items_of

    kind = output.suffix.lower()
    if kind not in (".html", ".png", ".gif"):
        raise InputError(f"{output}: expected a name that ends in .html, .png or .gif")
    if times and kind != ".png":
        raise InputError(f"--time: instants of a picture; expected an output that ends in .png, not {kind}")
    inputs = [*files, *(file for file in (model, design) if file is not None)]
    with new_file(output, force=force, inputs=inputs) as unfinished:
        fitted = load_model(model, without)
        forward = None
        if fitted is not None:
            from sim import Simulator

            forward = Simulator(points_per_side(grid, fitted))
        items = items_of(files, trial=trial, design=design, model=fitted, forward=forward)
        if kind == ".html":
            from studies.view.page import render_page

            unfinished.write_text(render_page(output.stem, items), encoding="utf-8")
        elif kind == ".png":
            from studies.view.picture import save_picture

            save_picture(items, unfinished, times)
        else:
            from studies.view.picture import save_animation

            save_animation(items, unfinished)
    panels = [{"title": item.title, "frames": len(item.frames)} for item in items]
    said = ", ".join(f"{panel['title']} ({panel['frames']} frames)" for panel in panels)
    print_result({"file": str(output), "panels": panels}, f"{output}: {said}", as_json)
