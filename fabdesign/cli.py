"""The command line. Each command parses, calls one function and prints; heavy imports stay inside the commands."""

import json
import os
import sys
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import click

from fabdesign import __version__
from fabdesign.errors import InputError, SimulationError
from fabdesign.model import Model

_FILE = click.Path(path_type=Path)
_EXTRAS = {"open3d": "clouds", "trimesh": "mesh", "numba": "rig", "ezdxf": "dxf"}
_grid = click.option("--grid", type=int, help="Grid points a side; by default the model's, or 41.")
_as_json = click.option("--json", "as_json", is_flag=True, help="Print a machine-readable result.")


def main() -> None:
    """Run the command line: exit 0 on success, 2 on bad input and 1 on other failures, each with one line."""
    try:
        commands.main(prog_name="fabdesign", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(2)
    except click.ClickException as error:
        _fail(error.format_message(), error.exit_code)
    except InputError as error:
        _fail(str(error), 2)
    except SimulationError as error:
        _fail(str(error), 1)
    except ModuleNotFoundError as error:
        if error.name not in _EXTRAS:
            raise
        _fail(f"needs {error.name}; install it with: pip install 'fabdesign[{_EXTRAS[error.name]}]'", 1)
    except click.exceptions.Abort:
        _fail("interrupted", 130)


def _fail(message: str, code: int) -> None:
    click.echo(f"fabdesign: {' '.join(message.split())}", err=True)
    sys.exit(code)


def _progress(verb: str, what: str = "trials") -> Callable[[int, int], None]:
    return lambda done, total: click.echo(f"{verb} {done} of {total} {what}", err=True)


def _points(grid: int | None, model: Model | None) -> int:
    """Points a side: as asked for, else what the model's factors were found on."""
    return grid or (model or Model()).grid


def _report(result: dict[str, Any], text: str, as_json: bool) -> None:
    click.echo(json.dumps(result) if as_json else text)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
def commands() -> None:
    """Design fabric actuators: a cloth with McKibben muscles laced through it.

    Files and options are in metres, seconds, newtons and kPa; errors are shown in millimetres.
    """


@commands.command()
@click.option("-o", "--output", type=_FILE, default=Path("demo"), show_default=True, help="The folder to write to.")
@_as_json
def demo(output: Path, as_json: bool) -> None:
    """Do the main job on embedded data: a measured cloud becomes a layout, pressures and a report."""
    from studies.demo import as_json as json_of
    from studies.demo import as_text, run_demo
    from studies.progress import LiveLine

    with LiveLine("demo") as line:
        results = run_demo(output, progress=lambda name, search: line.show(search))
    _report(json_of(results), f"{as_text(results)}\nreport: {output / 'report.html'}", as_json)


@commands.command()
@click.argument("layout")
@click.option("-o", "--output", type=_FILE, required=True, help="The design file to write (TOML).")
@click.option("--name", help="The design's name; the layout's by default.")
@click.option("--width", type=float, help="Of the cloth, m.")
@click.option("--height", type=float, help="Of the cloth, m.")
@click.option("--muscles", type=int, help="How many.")
@click.option("--pitch", type=float, default=0.02, show_default=True, help="Of the fixed points, m.")
@_as_json
def new(
    layout: str,
    output: Path,
    name: str | None,
    width: float | None,
    height: float | None,
    muscles: int | None,
    pitch: float,
    as_json: bool,
) -> None:
    """Write a catalogue LAYOUT (basic, side, cross, vertical) as a design file."""
    from fabdesign.catalogue import build
    from fabdesign.design_file import write_design

    design = build(layout, width=width, height=height, muscles=muscles, fixed_point_pitch=pitch, name=name)
    write_design(design, output)
    result = {"design": str(output), "muscles": len(design.muscles), "channels": design.channels}
    _report(result, f"{output}: {layout}, {len(design.muscles)} muscles on {design.channels} channels", as_json)


@commands.command()
@click.argument("files", nargs=-1, required=True, type=_FILE)
@_as_json
def check(files: tuple[Path, ...], as_json: bool) -> None:
    """Say whether FILES are sound: designs, trials, sets, pressures, bench tables, models."""
    from fabdesign.check import problems

    found = {str(file): problems(file) for file in files}
    if as_json:
        click.echo(
            json.dumps({"files": {name: {"sound": not lines, "problems": lines} for name, lines in found.items()}})
        )
    for name, lines in found.items():
        for line in lines:
            click.echo(f"fabdesign: {line}", err=True)
        if not lines and not as_json:
            click.echo(f"{name}: sound")
    if any(found.values()):
        sys.exit(2)


@commands.command()
@click.argument("design", type=_FILE)
@click.option("-o", "--output", type=_FILE, required=True, help="The folder to write to.")
@_as_json
def export(design: Path, output: Path, as_json: bool) -> None:
    """Write 1:1 sewing templates of a DESIGN (SVG, one a face; DXF with the extra dxf) and its cut list (CSV)."""
    from fabdesign.design_file import read_design
    from fabdesign.export import export_design

    files = [str(file) for file in export_design(read_design(design), output, stem=design.stem)]
    _report({"files": files}, "\n".join(files), as_json)


@commands.command()
@click.argument("design", type=_FILE)
@click.option("--pressures", help='kPa: a CSV, a trial\'s npz, or one constant row such as "400,0,200".')
@click.option("--model", type=_FILE, help="A model file; the data sheet holds without one.")
@click.option("--duration", type=float, help="Of the motion, s; the pressures' by default.")
@click.option("--frame-rate", type=float, default=60.0, show_default=True, help="Hz.")
@click.option(
    "--self-contact", is_flag=True, help="Layers of the cloth do not pass through each other; 5 to 8 times slower."
)
@_grid
@click.option("-o", "--output", type=_FILE, required=True, help="The npz to write: time, points.")
@_as_json
def simulate(
    design: Path,
    pressures: str | None,
    model: Path | None,
    duration: float | None,
    frame_rate: float,
    self_contact: bool,
    grid: int | None,
    output: Path,
    as_json: bool,
) -> None:
    """Simulate the motion of a DESIGN under given pressures, from rest."""
    from fabdesign.design_file import read_design
    from fabdesign.model_file import read_model
    from fabdesign.output import new_file
    from fabdesign.pressure_file import constant_program, read_pressures
    from studies.predict import frame_times, save_motion
    from studies.predict import simulate as simulate_motion

    loaded = read_design(design)
    if pressures is None and loaded.channels:
        raise InputError(f"{design}: has {loaded.channels} channels; expected --pressures for them")
    program = constant_program([]) if pressures is None else read_pressures(pressures, loaded)
    times = frame_times(program, duration=duration, frame_rate=frame_rate)
    fitted = None if model is None else read_model(model)
    with new_file(output) as unfinished:
        os.environ.setdefault("FABDESIGN_LANES", "2")  # kernels for a lone design
        from sim import Simulator

        simulator = Simulator(_points(grid, fitted), self_contact=self_contact)
        points = simulate_motion(simulator, loaded, program, times, model=fitted)
        save_motion(unfinished, times, points)
    result = {"motion": str(output), "frames": len(times), "points": points.shape[1]}
    _report(result, f"{output}: {len(times)} frames of {points.shape[1]} points", as_json)


@commands.command()
@click.argument("source", type=_FILE)
@click.option("--model", type=_FILE, required=True, help="A model file.")
@click.option("--design", type=_FILE, help="Of a lone trial; a set names its own.")
@_grid
@click.option("-o", "--output", type=_FILE, required=True, help="The folder to write to.")
@_as_json
def predict(source: Path, model: Path, design: Path | None, grid: int | None, output: Path, as_json: bool) -> None:
    """Predict every trial of a set, or a lone TRIAL.npz, at its own times, as OUTPUT/trials/NAME.npz."""
    from fabdesign.design_file import read_design
    from fabdesign.model_file import read_model
    from studies.predict import predict as predict_trials
    from studies.predict import trials_of

    fitted = read_model(model)
    trials = trials_of(source, None if design is None else read_design(design))
    from sim import Simulator

    predict_trials(Simulator(_points(grid, fitted)), fitted, trials, output, progress=_progress("predicted"))
    files = [str(output / "trials" / trial.file.name) for trial in trials]
    _report({"motions": files}, f"{output / 'trials'}: {len(files)} motions", as_json)


@commands.command()
@click.argument("source", type=_FILE)
@click.option("--fit", help="What to fit, by comma: orders of trials, names of records; all of role fit without it.")
@click.option("--skip-bad", is_flag=True, help="Leave out a set's unsound trials, and list them.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the points and frames drawn.")
@click.option("--grid", default=61, show_default=True, help="Grid points a side of the last iterations; the model's.")
@click.option("-o", "--output", type=_FILE, required=True, help="The model, or of a bench the type, to write (TOML).")
@_as_json
def calibrate(source: Path, fit: str | None, skip_bad: bool, seed: int, grid: int, output: Path, as_json: bool) -> None:
    """Fit the declared parameters to SOURCE, a measurement set; or the law of a bench (a folder with bench.toml)."""
    if source.name == "bench.toml" or (source / "bench.toml").is_file():
        _calibrate_bench(source, fit, output, as_json)
        return
    from fabdesign.measurement_set import read_set
    from fabdesign.model_file import write_model
    from fabdesign.output import new_file
    from studies.bad_data import sound_trials
    from studies.calibrate import calibrate as calibrate_set
    from studies.calibrate import orders_of
    from studies.calibrate_report import as_text

    measured, skipped = sound_trials(read_set(source), skip_bad=skip_bad)
    orders = None if fit is None else orders_of(fit)
    with new_file(output) as unfinished:
        from sim import Simulator

        found = calibrate_set(
            measured,
            Simulator(grid),
            slopes=Simulator(min(grid, 41)),
            orders=orders,
            skipped=skipped,
            skip_bad=skip_bad,
            seed=seed,
            progress=lambda line: click.echo(line, err=True),
        )
        write_model(replace(found.model, points_per_side=grid), unfinished)
    _report(found.as_json() | {"model": str(output)}, f"{output}: {as_text(found)}", as_json)


def _calibrate_bench(source: Path, fit: str | None, output: Path, as_json: bool) -> None:
    from studies.bench_calibrate import calibrate_bench, write_bench_type

    fitted = calibrate_bench(source, fit=None if fit is None else fit.split(","))
    files = [str(file) for file in write_bench_type(fitted, output)]
    result = {
        "bench": fitted.bench.name,
        "unit": fitted.unit,
        "error_fit": fitted.error_fit,
        "error_left_out": fitted.error_left_out,
        "error_test": fitted.error_test,
        "constants": {name: {"value": c.value, "unit": c.unit} for name, c in fitted.constants.items()},
        "files": files,
    }
    _report(result, f"{files[0]}: {fitted.bench.name}, {fitted.error_fit:.3g} {fitted.unit} RMS on the fit", as_json)


@commands.command()
@click.argument("sets", nargs=-1, required=True, type=_FILE)
@click.option("--model", type=_FILE, required=True, help="A model file.")
@click.option("--all", "all_trials", is_flag=True, help="Trials of role fit too, in a table of their own.")
@click.option("--skip-bad", is_flag=True, help="Leave out a set's unsound trials, and list them.")
@_grid
@click.option("-o", "--output", type=_FILE, help="A folder for tables, a picture and the whole result.")
@_as_json
def evaluate(
    sets: tuple[Path, ...],
    model: Path,
    all_trials: bool,
    skip_bad: bool,
    grid: int | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Say how far a model's motions are from the measured ones of SETS, before and after, in mm."""
    from fabdesign.measurement_set import read_set
    from fabdesign.model_file import read_model
    from fabdesign.output import new_folder
    from studies.bad_data import sound_trials
    from studies.evaluate import evaluate_sets
    from studies.evaluation_report import tables_markdown, write_evaluation
    from studies.predict import factors_of

    fitted = read_model(model)
    factors_of(fitted)
    checked = [sound_trials(read_set(path), skip_bad=skip_bad) for path in sets]
    measured, skipped = [found for found, _ in checked], [line for _, lines in checked for line in lines]
    with nullcontext() if output is None else new_folder(output) as unfinished:
        from sim import Simulator

        evaluation = evaluate_sets(
            fitted, measured, Simulator(_points(grid, fitted)), all_trials=all_trials, progress=_progress("evaluated")
        )
        if unfinished is not None:
            write_evaluation(evaluation, unfinished)
    text = "\n".join([tables_markdown(evaluation), *(f"skipped: {line}" for line in skipped)])
    _report(evaluation.as_json() | {"skipped": skipped}, text, as_json)


@commands.command()
@click.argument("study", type=_FILE)
@click.option("-o", "--output", type=_FILE, required=True, help="The folder to write to, or to go on in.")
@_as_json
def optimize(study: Path, output: Path, as_json: bool) -> None:
    """Find the layout and pressures that come closest to the target of a STUDY (TOML). Ctrl-C ends with the best."""
    from studies.layouts import run_study
    from studies.progress import LiveLine

    with LiveLine(study.stem) as line:
        result = run_study(study, output, progress=line.show).as_json()
    text = (
        f"{output}: {result['objective_mm']:.3f} mm (Chamfer {result['chamfer']:.3f}, floor "
        f"{result['chamfer_floor']:.3f}) after {result['evaluations']} evaluations; {result['stop_reason']}"
    )
    _report(result, text, as_json)


@commands.command()
@click.argument("design", type=_FILE)
@click.argument("more", nargs=-1, metavar="[P.csv]...")
@click.option("--pressures", multiple=True, required=True, help="A trial each; further ones may just follow.")
@click.option("--key", type=_FILE, help="What the specimen really is; not written into the set.")
@click.option("--recording", type=_FILE, help="A folder for four depth cameras' raw clouds of the first trial.")
@click.option("--test-trials", type=int, default=0, show_default=True, help="How many of the last have role test.")
@click.option("-o", "--output", type=_FILE, required=True, help="The measurement set to write.")
@_as_json
def rig(
    design: Path,
    more: tuple[str, ...],
    pressures: tuple[str, ...],
    key: Path | None,
    recording: Path | None,
    test_trials: int,
    output: Path,
    as_json: bool,
) -> None:
    """Measure a DESIGN on a virtual rig, another engine than `simulate`'s, as a measurement set."""
    from studies.rig import run_rig

    programs = [*pressures, *more]
    run_rig(
        design,
        programs,
        out=output,
        key=key,
        recording=recording,
        test_trials=test_trials,
        progress=_progress("measured"),
    )
    recorded = None if recording is None else str(recording)
    result = {"set": str(output), "trials": len(programs), "recording": recorded}
    _report(result, f"{output}: {len(programs)} trials of a synthetic rig", as_json)


@commands.command()
@click.argument("recording", type=_FILE)
@click.option("--points", type=int, default=3362, show_default=True, help="Sampled a frame.")
@click.option("--per-frame", is_flag=True, help="Refine the sensors' poses for each frame.")
@click.option(
    "--convention",
    type=click.Choice(["forward", "backward"]),
    default="forward",
    show_default=True,
    help="Camera axes of the clouds: z forward and y down, or (x, -y, -z) as RealSense SDKs export.",
)
@click.option("--skip-bad", is_flag=True, help="Leave out what is unsound, and list it.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("-o", "--output", type=_FILE, required=True, help="The measurement set to write.")
@_as_json
def fuse(
    recording: Path,
    points: int,
    per_frame: bool,
    convention: Literal["forward", "backward"],
    skip_bad: bool,
    seed: int,
    output: Path,
    as_json: bool,
) -> None:
    """Register and fuse the depth sensors of a RECORDING into a measurement set."""
    from studies.fuse import fuse as fuse_recording

    report = fuse_recording(
        recording,
        output,
        points=points,
        per_frame=per_frame,
        convention=convention,
        skip_bad=skip_bad,
        seed=seed,
        progress=_progress("fused", "frames"),
    )
    worst = max(sensor.residual_mm for sensor in report.sensors)
    lines = [f"{output}: {report.frames} frames, {len(report.sensors)} sensors within {worst:.2f} mm RMS of the cloth"]
    _report(asdict(report), "\n".join([*lines, *(f"skipped: {what}" for what in report.skipped)]), as_json)
