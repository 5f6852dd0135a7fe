"""Draw a layout in the browser and see the cloth move."""

import json
from pathlib import Path

import click

from fabdesign.cli.console import FILE, commands, json_option


@commands.command()
@click.argument("files", nargs=-1, type=FILE, metavar="[FILE]...")
@click.option("--model", type=FILE, help="A model file; by default the data sheet.")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address to listen on; any other than this one needs a token.",
)
@click.option("--port", type=click.IntRange(1, 65535), help="Port; by default the first free one from 8080.")
@click.option("--no-browser", is_flag=True, help="Only print the address.")
@json_option
def studio(
    files: tuple[Path, ...], model: Path | None, host: str, port: int | None, no_browser: bool, as_json: bool
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

    serve(open_files(files, model), host=host, port=port, announce=announce, browser=not no_browser)
