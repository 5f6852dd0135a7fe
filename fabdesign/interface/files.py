"""Designs and files: write them, check them, make templates of them, look at them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

from fabdesign.errors import InputError
from fabdesign.interface.run import Run, many_of, paths_of, simulator
from fabdesign.interface.verb import DesignLike, File, Folder, Looking, ModelLike, Placing, Shown, Toml, Writing, verb

if TYPE_CHECKING:
    from fabdesign.clouds.target_file import AsTarget
    from fabdesign.drawings.sewing import Exported
    from fabdesign.nouns.design import Design
    from studies.check.findings import Findings


def _written(design: Design, given: Mapping[str, Any]) -> Shown:
    out, muscles = given["out"], len(design.muscles)
    content = {"design": str(out), "muscles": muscles, "channels": design.channels}
    return Shown(content, f"{out}: {given['layout']}, {muscles} muscles on {design.channels} channels")


@verb(_written)
def new(
    layout: str,
    out: Toml | None = None,
    *,
    name: str | None = None,
    width: float | None = None,
    height: float | None = None,
    muscles: int | None = None,
    muscle_type: str | None = None,
    bench: File | None = None,
    pitch: float = 0.02,
    **given: Unpack[Writing],
) -> Design:
    """Write a layout of the catalogue as a design file.

    LAYOUT is basic, side, cross or vertical.

    out: The design file to write (TOML).
    name: Name of the design; by default that of the layout.
    width: Width of the cloth, m.
    height: Height of the cloth, m.
    muscles: Number of muscles.
    muscle_type: Name of your own muscle type; needs --bench.
    bench: Its file: TYPE.toml of `calibrate BENCH`, or a table pressure_kpa,contraction,force_n.
    pitch: Distance between fixed points, m.

    `build` makes a design from objects, and writes nothing.
    """
    from fabdesign.files.design_file import write_design
    from fabdesign.nouns.catalogue import build, read_muscle_type

    if (muscle_type is None) != (bench is None):
        raise InputError("--muscle-type NAME and --bench FILE: one without the other; expected both")
    kind, effects = (None, ()) if bench is None else read_muscle_type(Path(bench), str(muscle_type))
    design = build(
        layout, width=width, height=height, muscles=muscles, muscle_type=kind, fixed_point_pitch=pitch, name=name
    )
    design = replace(design, effects=effects)
    with Run(**given).file(out, paths_of(bench)) as unfinished:
        if unfinished is not None:
            write_design(design, unfinished)
    return design


def _checked(findings: Mapping[str, Findings], given: Mapping[str, Any]) -> Shown:
    lines, text = [], []
    for name, of in findings.items():
        lines += [f"fabdesign: {line}" for line in of.problems]
        if of.sound:  # what is not sound is mended first
            lines += [*(f"warning: {line}" for line in of.warnings), *(f"note: {line}" for line in of.notes)]
            count = len(of.warnings)
            text.append(f"{name}: sound" + f", {count} warning{'' if count == 1 else 's'}" * bool(count))
    return Shown({"files": findings}, "\n".join(text), lines, 0 if all(of.sound for of in findings.values()) else 2)


@verb(_checked, "FILES...")
def check(files: Sequence[File] | File, **given: Unpack[Placing]) -> dict[str, Findings]:
    """Check whether FILES are valid and plausible.

    FILES are any files and folders that commands read. With --unit, --place or
    --rotation, and a design among FILES, clouds and
    meshes are checked as targets of that cloth.

    files: Any files and folders.

    Returns problems, warnings and notes of each file, by its name.
    """
    from fabdesign.clouds.target_file import AS_GIVEN
    from studies.check.files import fabric_of, inspect

    how, paths = _as_target(given), paths_of(files)
    fabric = fabric_of(paths) if how != AS_GIVEN else None
    if how.place == "fit" and fabric is None:
        raise InputError("--place fit: needs the cloth; expected a design among the files")
    return {str(file): inspect(file, replace(how, fabric=fabric)) for file in paths}


def _as_target(given: Placing | Looking) -> AsTarget:
    from fabdesign.clouds.target_file import AsTarget

    turn = given.pop("rotation", None)
    rotation: Any = None if turn is None else tuple(turn)
    return AsTarget(given.pop("unit", "m"), given.pop("place", "given"), rotation=rotation)


def _exported(made: Exported, given: Mapping[str, Any]) -> Shown:
    from fabdesign.nouns.pressure import poses_in_words

    return Shown(made, "\n".join([*map(str, made.files), *poses_in_words(made.pressures)]))


@verb(_exported)
def export(
    design: DesignLike,
    out: Folder,
    *,
    tail_length: float | None = None,
    seam_allowance: float = 0.01,
    paper: Literal["a4", "letter", "none"] = "a4",
    pressures: Sequence[File] = (),
    **given: Unpack[Writing],
) -> Exported:
    """Write sewing templates, a cut list and the pressures of a DESIGN.

    The templates are at 1:1. They are pages to print and glue (PDF), whole faces (SVG), and with the extra dxf a DXF
    file.

    tail_length: Free length at each end of a muscle, for tube and knot, m; by default its type's.
    seam_allowance: Cloth outside the edge, m.
    paper: Paper of the PDF's pages.
    pressures: Pressures to write too, a file for each pose; by default those beside a DESIGN that optimize wrote.
    """
    from fabdesign.drawings.sewing import Sewing, export_design, pressures_beside
    from fabdesign.interface.arguments import one_design

    read = one_design(design)
    file = Path(design) if isinstance(design, Path | str) else None
    chosen = paths_of([*pressures]) or ([] if file is None else pressures_beside(file))
    return export_design(
        read,
        Path(out),
        Sewing(None if paper == "none" else paper, seam_allowance, tail_length),
        stem=read.name if file is None else file.stem,
        pressures=chosen,
        force=Run(**given).force,
        inputs=[*paths_of(design), *chosen],
    )


def _viewed(panels: Sequence[Mapping[str, Any]], given: Mapping[str, Any]) -> Shown:
    out = _page_of(given["files"], given["out"])
    text = ", ".join(f"{panel['title']} ({panel['frames']} frames)" for panel in panels)
    return Shown({"file": str(out), "panels": [*panels]}, f"{out}: {text}")


def _page_of(files: Sequence[File], out: File | None) -> Path:
    return Path(f"{paths_of([*files])[0].resolve().stem}.html" if out is None else out)


@verb(_viewed, "FILES...", optional=True, title="showing")
def view(
    files: Sequence[File],
    out: File | None = None,
    *,
    model: ModelLike | None = None,
    design: File | None = None,
    trial: str | None = None,
    without: Sequence[str] = (),
    times: Sequence[float] = (),
    markers: Sequence[str] = (),
    overlay: bool = False,
    grid: int | None = None,
    **given: Unpack[Looking],
) -> list[dict[str, Any]]:
    """Show motions, measured clouds and meshes side by side.

    FILES are motions, measurement sets, trials, clouds and meshes. With --model each trial has its prediction too.

    out: File to write. The ending selects the kind: .html (turns and plays), .png, .gif, .mp4, .glb (animated), .pvd
        (ParaView), .rrd (Rerun) or .csv (markers). By default the first file's name with .html.
    model: A model file: show its prediction beside each trial.
    design: Design of a single trial that is to be predicted, or of --place fit.
    trial: Name of the trial of a set; by default the first.
    times: Time of a picture in a PNG, s; may be given several times.
    markers: Point of the cloth for a CSV, m; may be given several times.
    overlay: Lay what a panel is compared with, such as the measured cloud, over it.

    Returns title, number of frames and notes of each panel. A marker is "NAME=U,V".
    """
    from fabdesign.files.design_file import read_design
    from fabdesign.output import new_files
    from studies.view.items import items_of
    from studies.view.write import KINDS, require_writer, write_panels

    how, run = _as_target(given), Run(**given)  # type: ignore[misc]
    paths, out = paths_of([*many_of("files", files)]), _page_of(files, out)
    kind = out.suffix.lower()
    if kind not in KINDS:
        raise InputError(f"{out}: expected a name that ends in {', '.join(KINDS[:-1])} or {KINDS[-1]}")
    for option, asked, what, fitting in (
        ("--time", times, "instants of a picture", (".png",)),
        ("--marker", markers, "points in a table", (".csv",)),
        ("--overlay", overlay, "of pictures", (".html", ".png", ".gif", ".mp4")),
    ):
        if asked and kind not in fitting:
            ends = " or ".join(filter(None, (", ".join(fitting[:-1]), fitting[-1])))
            raise InputError(f"{option}: {what}; expected an output that ends in {ends}, not {kind}")
    if how.place == "fit" and design is None:
        raise InputError("--place fit: needs the cloth; expected --design with its design file")
    require_writer(kind)  # before anything is computed
    places = dict(_marker(text) for text in markers)
    if len(places) < len(markers):
        raise InputError(f"--marker: {', '.join(markers)}; expected a name of its own for each")
    design = None if design is None else Path(design)
    with new_files(out, force=run.force, inputs=[*paths, *paths_of(model, design)]) as unfinished:
        fitted = run.model(model, without)
        forward = None if fitted is None else simulator(run.side(grid, fitted))
        if how.place == "fit" and design is not None:
            how = replace(how, fabric=read_design(design).fabric)
        items = items_of(paths, trial=trial, design=design, model=fitted, forward=forward, how=how)
        notes = write_panels(items, unfinished, times=times, markers=places, overlay=overlay)
    panels: list[dict[str, Any]] = [{"title": item.title, "frames": len(item.frames)} for item in items]
    return [{**panel, **note} for panel, note in zip(panels, notes or [{}] * len(panels), strict=True)]


def _marker(text: str) -> tuple[str, tuple[float, float]]:
    name, _, place = text.partition("=")
    try:
        u, v = (float(cell) for cell in place.split(","))
    except ValueError:
        u = v = float("nan")
    if not name.strip() or not u == u or not v == v:
        raise InputError(f"--marker {text}: expected NAME=U,V with a place on the cloth in metres, such as tip=0.1,0.2")
    return name.strip(), (u, v)


@verb(None, "[FILE]...")
def studio(
    files: Sequence[File] = (),
    *,
    model: File | None = None,
    host: str = "127.0.0.1",
    port: int | None = None,
    no_browser: bool = False,
    announce: Callable[[str], None] = print,
    **given: Unpack[Placing],
) -> None:
    """Draw a layout in the browser. FILES: a design, study or measurement set, and with it a target and pressures.

    Without FILES the studio starts with a layout of the catalogue. The address is the first line of standard output.
    Ctrl-C ends the studio; unsaved work is there at the next start.

    host: Address to listen on; not encrypted on any other than this one.
    no_browser: Only print the address.

    announce: is called with the address.
    """
    import viser  # noqa: F401 first: without the extra one line says how to install it

    from studies.studio.opening import open_files
    from studies.studio.server import serve

    opened = open_files(paths_of([*files]), None if model is None else Path(model), _as_target(given))
    serve(opened, host=host, port=port, announce=announce, browser=not no_browser)
