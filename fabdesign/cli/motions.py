"""Motions of a design: simulate, predict what was measured, and say how far off that is."""

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from fabdesign.cli.console import (
    FILE,
    FINITE,
    FOLDER,
    SEED,
    NumberRange,
    OutputPath,
    cluster_option,
    commands,
    force_option,
    grid_option,
    json_option,
    points_per_side,
    print_result,
    skip_bad_option,
    tell,
)
from fabdesign.cli.models import effects_option, load_model, parts_of, without_option
from fabdesign.cli.progress import described
from fabdesign.errors import InputError
from fabdesign.json_file import write_json


@commands.command()
@click.argument("design", type=FILE)
@click.option(
    "--pressures",
    help='Pressures: a CSV, a trial\'s npz, or one constant row such as "400,0,200", in kPa, or "4bar,0,29psi".',
)
@click.option("--model", type=FILE, help="A model file; by default the data sheet.")
@without_option
@effects_option
@click.option(
    "--order",
    type=SEED,
    default=0,
    show_default=True,
    help="Place of the motion in the session; 0 is a rested specimen.",
)
@click.option("--duration", type=FINITE, help="Duration of the motion, s; by default that of the pressures.")
@click.option("--frame-rate", type=FINITE, default=60.0, show_default=True, help="Frames a second, Hz.")
@click.option("--equilibrium", is_flag=True, help="One frame: the shape at rest under the last pressures.")
@click.option(
    "--rise",
    type=NumberRange(0.01, 60),
    help="With --equilibrium: time in which the pressures rise, s; by default 1.",
)
@click.option(
    "--hold",
    type=NumberRange(0, 3600),
    help="With --equilibrium: time for which they then hold, s; by default 10.",
)
@click.option(
    "--mesh", type=FILE, help="Write meshes too: NAME.ply or NAME.obj gives NAME_0000.ply, ..., a file per frame."
)
@click.option(
    "--self-contact", is_flag=True, help="Layers of the cloth do not pass through each other; 5 to 8 times slower."
)
@grid_option
@click.option("-o", "--output", type=OutputPath(".npz"), required=True, help="The npz to write: time, points.")
@force_option
@json_option
def simulate(
    design: Path,
    pressures: str | None,
    model: Path | None,
    without: str | None,
    order: int,
    duration: float | None,
    frame_rate: float,
    equilibrium: bool,
    rise: float | None,
    hold: float | None,
    mesh: Path | None,
    self_contact: bool,
    grid: int | None,
    output: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Simulate the motion of a DESIGN under pressures."""
    import numpy as np

    from fabdesign.design_file import read_design
    from fabdesign.forward import HOLD, RISE
    from fabdesign.motion_file import mesh_paths, square_triangles, write_mesh, write_motion
    from fabdesign.output import new_file, new_files
    from fabdesign.pressure import rising_program
    from fabdesign.pressure_file import constant_program, read_pressures, told_slight
    from studies.forward_model import extrapolated
    from studies.predict import frame_times, moved, rested

    loaded = read_design(design)
    if pressures is None and loaded.channels:
        raise InputError(f"{design}: has {loaded.channels} channels; expected --pressures for them")
    program = constant_program([]) if pressures is None else read_pressures(pressures, loaded)
    if equilibrium and duration is not None:
        raise InputError(f"--duration {duration:g}: a shape at rest has none; expected it without --equilibrium")
    if not equilibrium and (rise is not None or hold is not None):
        raise InputError("--rise and --hold: of a shape at rest; expected them with --equilibrium")
    fitted = load_model(model, without)
    side = points_per_side(grid, fitted)
    times = frame_times(program, duration=duration, frame_rate=frame_rate, points_per_side=side)
    if equilibrium:
        times = np.array([program.duration])  # a motion that is over
    mesh_files = [] if mesh is None else mesh_paths(mesh, len(times))
    inputs = [file for file in (design, model, pressures) if file is not None]
    with ExitStack() as stack:
        unfinished = stack.enter_context(new_file(output, force=force, inputs=inputs))
        meshes: list[Path] = []
        if mesh_files:
            names = [file.name for file in mesh_files]
            first = new_files(mesh_files[0], companions=names[1:], force=force, inputs=inputs)
            folder = stack.enter_context(first).parent
            meshes = [folder / name for name in names]
        os.environ.setdefault("FABDESIGN_LANES", "2")  # kernels for a lone design
        from sim import Simulator

        rise, hold = RISE if rise is None else rise, HOLD if hold is None else hold
        acting = rising_program(program.pressure[-1], rise, rise) if equilibrium else program
        for line in extrapolated(fitted, [acting]):
            tell(line)
        simulator = Simulator(side, self_contact=self_contact, rise=rise, hold=hold)
        if equilibrium:
            motion = rested(simulator, loaded, program, model=fitted, order=order)
        else:
            motion = moved(simulator, loaded, program, times, model=fitted, order=order)
        write_motion(unfinished, times, motion.points, size=motion.size, muscles=motion.muscles)
        for file, frame in zip(meshes, motion.points, strict=mesh is not None):
            write_mesh(file, frame, square_triangles(len(frame)))
    result: dict[str, Any] = {"motion": str(output), "frames": len(times), "points": motion.points.shape[1]}
    if mesh_files:
        result["meshes"] = [str(file) for file in mesh_files]
    if pressures is not None and (slight := told_slight(program, loaded, pressures)):
        tell(f"note: {slight}")
    what = "the shape at rest," if equilibrium else f"{len(times)} frames of"
    print_result(result, f"{output}: {what} {motion.points.shape[1]} points", as_json)


@commands.command()
@click.argument("sources", nargs=-1, required=True, type=FILE, metavar="SET...")
@click.option("--model", type=FILE, required=True, help="A model file.")
@without_option
@effects_option
@click.option("--design", type=FILE, help="Design of a single trial file.")
@grid_option
@cluster_option
@click.option("-o", "--output", type=FOLDER, required=True, help="The folder to write to.")
@force_option
@json_option
def predict(
    sources: tuple[Path, ...],
    model: Path,
    without: str | None,
    design: Path | None,
    grid: int | None,
    output: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Predict the motion of every trial of a SET.

    SET can also be a single TRIAL.npz. Each motion has the times of its trial. The command writes
    OUTPUT/trials/NAME.npz, for several sets OUTPUT/SET/trials/NAME.npz.
    """
    from fabdesign import interface
    from fabdesign.motion_file import read_band
    from fabdesign.units import in_mm
    from studies.intervals.band import mean_width, width_in_words

    with described("predicting") as shown:
        prediction = interface.predict(
            model,
            sources,
            output,
            without=parts_of(without),
            design=design,
            grid=grid,
            force=force,
            progress=shown,
            say=tell,
        )
    files = [str(file) for file in prediction]
    bands = [band for file in prediction if (band := read_band(Path(file))) is not None]
    width = in_mm(mean_width(bands)) if bands else None
    lines = [f"{output}: {len(files)} motions", *([width_in_words(bands)] if bands else [])]
    print_result({"motions": files, "interval_width_mm": width}, "\n".join(lines), as_json)


@commands.command()
@click.argument("sets", nargs=-1, required=True, type=FILE)
@click.option("--model", type=FILE, required=True, help="A model file; for a bench the file that calibrate wrote.")
@without_option
@effects_option
@click.option("--all", "all_trials", is_flag=True, help="Evaluate trials of role fit too, in a second table.")
@skip_bad_option
@grid_option
@cluster_option
@click.option("-o", "--output", type=FOLDER, help="A folder for tables, a picture and the whole result.")
@force_option
@json_option
def evaluate(
    sets: tuple[Path, ...],
    model: Path,
    without: str | None,
    all_trials: bool,
    skip_bad: bool,
    grid: int | None,
    output: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Print the error of a model on measured SETS, in mm.

    "Before" is the model without effects and corrector, or the data sheet. "After" is the whole model. Trials of role
    test are evaluated: nothing was fitted to them. SETS can also be one bench (a folder with bench.toml); its model is
    the file that calibrate wrote.
    """
    from fabdesign.bench_file import is_bench

    if any(is_bench(source) for source in sets):
        _evaluate_bench(sets, model, all_trials, output, force, as_json)
        return
    from fabdesign import interface
    from studies.evaluation_report import tables_markdown

    with described("evaluating") as shown:
        evaluated = interface.evaluate(
            model,
            sets,
            output,
            without=parts_of(without),
            all_trials=all_trials,
            skip_bad=skip_bad,
            grid=grid,
            force=force,
            progress=shown,
            say=tell,
        )
    skipped = [*evaluated.skipped]
    text = "\n".join([tables_markdown(evaluated.found), *(f"skipped: {line}" for line in skipped)])
    print_result(evaluated.found.as_json() | {"skipped": skipped}, text, as_json)


def _evaluate_bench(
    sources: tuple[Path, ...], law: Path, all_records: bool, output: Path | None, force: bool, as_json: bool
) -> None:
    from fabdesign.output import new_folder, write_text
    from studies.benches.evaluate import evaluate_bench

    if len(sources) > 1:
        raise InputError(f"{sources[0]}: a bench among {len(sources)} sources; expected a bench alone, or sets")
    evaluation = evaluate_bench(sources[0], law, all_records=all_records)
    if output is not None:
        with new_folder(output, made_by="evaluate", force=force, inputs=[*sources, law]) as files:
            write_json(files / "evaluation.json", evaluation.as_json())
            write_text(files / "evaluation.md", evaluation.as_markdown() + "\n")
    print_result(evaluation.as_json(), evaluation.as_markdown(), as_json)
