"""Look at motions, measured clouds and predictions, and draw a layout in the browser."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

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
    target_options,
)
from fabdesign.cli.models import effects_option, load_model, without_option
from fabdesign.errors import InputError

if TYPE_CHECKING:
    from fabdesign.target_file import AsTarget


@commands.command()
@click.argument("files", nargs=-1, required=True, type=FILE)
@click.option("--model", type=FILE, help="A model file: show its prediction beside each trial.")
@click.option("--design", type=FILE, help="Design of a single trial that is to be predicted, or of --place fit.")
@click.option("--trial", help="Name of the trial of a set; by default the first.")
@without_option
@effects_option
@click.option(
    "--time", "times", multiple=True, type=FINITE, help="Time of a picture in a PNG, s; may be given several times."
)
@click.option(
    "--marker",
    "markers",
    multiple=True,
    metavar="NAME=U,V",
    help="Point of the cloth for a CSV, m; may be given several times.",
)
@target_options
@click.option("--overlay", is_flag=True, help="Lay what a panel is compared with, such as the measured cloud, over it.")
@grid_option
@click.option(
    "-o",
    "--output",
    type=FILE,
    help="File to write. The ending selects the kind: .html (turns and plays), .png, .gif, .mp4, .glb (animated), .pvd "
    "(ParaView), .rrd (Rerun) or .csv (markers). By default the first file's name with .html.",
)
@force_option
@json_option
def view(
    files: tuple[Path, ...],
    model: Path | None,
    without: str | None,
    design: Path | None,
    trial: str | None,
    times: tuple[float, ...],
    markers: tuple[str, ...],
    how: "AsTarget",
    overlay: bool,
    grid: int | None,
    output: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Show motions, measured clouds and meshes side by side.

    FILES are motions, measurement sets, trials, clouds and meshes. With --model each trial has its prediction too.
    """
    from fabdesign.design_file import read_design
    from fabdesign.output import new_files
    from studies.view.items import items_of
    from studies.view.write import KINDS, require_writer, writer

    output = Path(f"{files[0].resolve().stem}.html") if output is None else output
    kind = output.suffix.lower()
    if kind not in KINDS:
        raise InputError(f"{output}: expected a name that ends in {', '.join(KINDS[:-1])} or {KINDS[-1]}")
    if times and kind != ".png":
        raise InputError(f"--time: instants of a picture; expected an output that ends in .png, not {kind}")
    if markers and kind != ".csv":
        raise InputError(f"--marker: points in a table; expected an output that ends in .csv, not {kind}")
    if how.place == "fit" and design is None:
        raise InputError("--place fit: needs the cloth; expected --design with its design file")
    if overlay and kind not in (".html", ".png", ".gif", ".mp4"):
        raise InputError(
            f"--overlay: of pictures; expected an output that ends in .html, .png, .gif or .mp4, not {kind}"
        )
    require_writer(kind)  # before anything is computed
    places = dict(_marker(text) for text in markers)
    if len(places) < len(markers):
        raise InputError(f"--marker: {', '.join(markers)}; expected a name of its own for each")
    inputs = [*files, *(file for file in (model, design) if file is not None)]
    with new_files(output, force=force, inputs=inputs) as unfinished:
        fitted = load_model(model, without)
        forward = None
        if fitted is not None:
            from sim import Simulator

            forward = Simulator(points_per_side(grid, fitted))
        if how.place == "fit" and design is not None:
            how = replace(how, fabric=read_design(design).fabric)
        items = items_of(files, trial=trial, design=design, model=fitted, forward=forward, how=how)
        more = writer(kind, times, places, overlay=overlay)(items, unfinished)
    panels = [{"title": item.title, "frames": len(item.frames)} for item in items]
    for panel, distance in zip(panels, more, strict=bool(more)):
        panel |= distance
    said = ", ".join(f"{panel['title']} ({panel['frames']} frames)" for panel in panels)
    print_result({"file": str(output), "panels": panels}, f"{output}: {said}", as_json)


def _marker(text: str) -> tuple[str, tuple[float, float]]:
    name, _, place = text.partition("=")
    try:
        u, v = (float(cell) for cell in place.split(","))
    except ValueError:
        u = v = float("nan")
    if not name.strip() or not u == u or not v == v:
        raise InputError(f"--marker {text}: expected NAME=U,V with a place on the cloth in metres, such as tip=0.1,0.2")
    return name.strip(), (u, v)


@commands.command()
@click.argument("files", nargs=-1, type=FILE, metavar="[FILE]...")
@click.option("--model", type=FILE, help="A model file; by default the data sheet.")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address to listen on; not encrypted on any other than this one.",
)
@click.option("--port", type=click.IntRange(1, 65535), help="Port; by default the first free one from 8080.")
@click.option("--no-browser", is_flag=True, help="Only print the address.")
@target_options
@json_option
def studio(
    files: tuple[Path, ...],
    model: Path | None,
    host: str,
    port: int | None,
    no_browser: bool,
    how: "AsTarget",
    as_json: bool,
) -> None:
    """Draw a layout in the browser. FILES: a design, study or measurement set, and with it a target and pressures.

    Without FILES the studio starts with a layout of the catalogue. The address is the first line of standard output.
    Ctrl-C ends the studio; unsaved work is there at the next start.
    """
    import viser  # noqa: F401 first: without the extra one line says how to install it

    from studies.studio.opening import open_files
    from studies.studio.server import serve

    def announce(address: str) -> None:
        click.echo(json.dumps({"address": address}) if as_json else address)

    serve(
        open_files(files, model, how),
        host=host,
        port=port,
        announce=announce,
        browser=not no_browser,
    )
