"""Designs and files: write them, check them, make templates of them."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fabdesign.cli.console import (
    FILE,
    FINITE,
    FOLDER,
    OutputPath,
    commands,
    force_option,
    json_option,
    print_result,
    target_options,
    tell,
)
from fabdesign.errors import InputError, printable
from fabdesign.json_file import json_text
from fabdesign.units import in_kpa

if TYPE_CHECKING:
    from fabdesign.target_file import AsTarget


@commands.command()
@click.argument("layout")
@click.option("-o", "--output", type=OutputPath(".toml"), required=True, help="The design file to write (TOML).")
@click.option("--name", help="Name of the design; by default that of the layout.")
@click.option("--width", type=FINITE, help="Width of the cloth, m.")
@click.option("--height", type=FINITE, help="Height of the cloth, m.")
@click.option("--muscles", type=int, help="Number of muscles.")
@click.option("--muscle-type", metavar="NAME", help="Name of your own muscle type; needs --bench.")
@click.option(
    "--bench",
    type=FILE,
    help="Its file: TYPE.toml of `calibrate BENCH`, or a table pressure_kpa,contraction,force_n.",
)
@click.option("--pitch", type=FINITE, default=0.02, show_default=True, help="Distance between fixed points, m.")
@force_option
@json_option
def new(
    layout: str,
    output: Path,
    name: str | None,
    width: float | None,
    height: float | None,
    muscles: int | None,
    muscle_type: str | None,
    bench: Path | None,
    pitch: float,
    force: bool,
    as_json: bool,
) -> None:
    """Write a layout of the catalogue as a design file.

    LAYOUT is basic, side, cross or vertical.
    """
    from fabdesign.catalogue import build
    from fabdesign.design_file import write_design
    from fabdesign.output import new_files
    from fabdesign.own_muscle import read_own_muscle

    if (muscle_type is None) != (bench is None):
        raise InputError("--muscle-type NAME and --bench FILE: one without the other; expected both")
    kind, effects = (None, ()) if bench is None else read_own_muscle(bench, str(muscle_type))
    design = build(
        layout, width=width, height=height, muscles=muscles, muscle_type=kind, fixed_point_pitch=pitch, name=name
    )
    design = replace(design, effects=effects)
    with new_files(output, force=force, inputs=[] if bench is None else [bench]) as unfinished:
        write_design(design, unfinished)
    result = {"design": str(output), "muscles": len(design.muscles), "channels": design.channels}
    print_result(result, f"{output}: {layout}, {len(design.muscles)} muscles on {design.channels} channels", as_json)


@commands.command()
@click.argument("files", nargs=-1, required=True, type=FILE)
@target_options
@json_option
def check(files: tuple[Path, ...], how: "AsTarget", as_json: bool) -> None:
    """Check whether FILES are valid and plausible.

    FILES are any files and folders that commands read. With --unit, --place or
    --rotation, and a design among FILES, clouds and
    meshes are checked as targets of that cloth.
    """
    from fabdesign.target_file import AS_GIVEN
    from studies.check import fabric_of, inspect

    fabric = fabric_of(files) if how != AS_GIVEN else None
    if how.place == "fit" and fabric is None:
        raise InputError("--place fit: needs the cloth; expected a design among the files")
    findings = {str(file): inspect(file, replace(how, fabric=fabric)) for file in files}
    if as_json:
        listed = {
            name: {
                "sound": not of.problems,
                "problems": [*of.problems],
                "warnings": [*of.warnings],
                "notes": [*of.notes],
            }
            for name, of in findings.items()
        }
        click.echo(json_text({"files": listed}))
    for name, of in findings.items():
        for line in of.problems:
            tell(f"fabdesign: {line}")
        for line in () if of.problems else of.warnings:  # what is not sound is mended first
            tell(f"warning: {line}")
        for line in () if of.problems else of.notes:
            tell(f"note: {line}")
        if not of.problems and not as_json:
            click.echo(printable(f"{name}: sound") + _counted(of.warnings))
    if any(of.problems for of in findings.values()):
        sys.exit(2)


def _counted(warnings: tuple[str, ...]) -> str:
    if not warnings:
        return ""
    return f", {len(warnings)} warning{'' if len(warnings) == 1 else 's'}"


@commands.command()
@click.argument("design", type=FILE)
@click.option(
    "--tail-length",
    type=float,
    help="Free length at each end of a muscle, for tube and knot, m; by default its type's.",
)
@click.option("--seam-allowance", type=float, default=0.01, show_default=True, help="Cloth outside the edge, m.")
@click.option(
    "--paper",
    type=click.Choice(["a4", "letter", "none"]),
    default="a4",
    show_default=True,
    help="Paper of the PDF's pages.",
)
@click.option(
    "--pressures",
    type=FILE,
    multiple=True,
    help="Pressures to write too, a file for each pose; by default those beside a DESIGN that optimize wrote.",
)
@click.option("-o", "--output", type=FOLDER, required=True, help="The folder to write to.")
@force_option
@json_option
def export(
    design: Path,
    tail_length: float | None,
    seam_allowance: float,
    paper: str,
    pressures: tuple[Path, ...],
    output: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Write sewing templates, a cut list and the pressures of a DESIGN.

    The templates are at 1:1. They are pages to print and glue (PDF), whole faces (SVG), and with the extra dxf a DXF
    file.
    """
    from fabdesign.design_file import read_design
    from fabdesign.export import export_design, pressures_beside
    from fabdesign.pressure import poses_in_words

    chosen = pressures or pressures_beside(design)
    made = export_design(
        read_design(design),
        output,
        stem=design.stem,
        paper=None if paper == "none" else paper,
        seam_allowance=seam_allowance,
        tail_length=tail_length,
        pressures=chosen,
        force=force,
        inputs=[design, *chosen],
    )
    files = [str(file) for file in made.files]
    result = {
        "files": files,
        "pressures_kpa": [in_kpa(row).tolist() for row in made.pressures],
        "left_out": list(made.left_out),
    }
    print_result(result, "\n".join([*files, *poses_in_words(made.pressures)]), as_json)


@commands.command()
@click.argument("kind")
@json_option
def schema(kind: str, as_json: bool) -> None:
    """Print the JSON Schema of a kind of file, for editors.

    KIND is design, model, study, measurement-set, recording, bench, bench-law or key. An editor that knows it (taplo,
    for example) completes and checks a file while it is typed.
    """
    from studies.check.kinds import schema_of

    content = schema_of(kind)
    print_result(content, json_text(content, indent=1), as_json)
