"""Measured data: fuse recordings, calibrate on them, or measure a virtual rig."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import click

from fabdesign.cli.console import (
    FILE,
    FOLDER,
    GRID,
    SEED,
    IntegerRange,
    OutputPath,
    cluster_option,
    commands,
    force_option,
    json_option,
    print_result,
    skip_bad_option,
    tell,
)
from fabdesign.cli.models import effects_option
from fabdesign.cli.progress import counted, described
from fabdesign.errors import InputError


@commands.command()
@click.argument("recordings", type=FILE, nargs=-1, required=True, metavar="RECORDING...")
@click.option(
    "--points", type=IntegerRange(1, 100_000), default=3362, show_default=True, help="Points sampled per frame."
)
@click.option("--per-frame", is_flag=True, help="Refine the sensors' poses for each frame.")
@click.option(
    "--convention",
    type=click.Choice(["forward", "backward"]),
    default="forward",
    show_default=True,
    help="Camera axes of the clouds: z forward and y down, or (x, -y, -z) as RealSense SDKs export.",
)
@click.option("--skip-bad", is_flag=True, help="Leave out invalid frames and recordings, and list them.")
@click.option("--seed", type=SEED, default=0, show_default=True)
@click.option("-o", "--output", type=FOLDER, required=True, help="The measurement set to write.")
@force_option
@json_option
def fuse(
    recordings: tuple[Path, ...],
    points: int,
    per_frame: bool,
    convention: Literal["forward", "backward"],
    skip_bad: bool,
    seed: int,
    output: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Make a measurement set from clouds of depth sensors.

    The sensors of each RECORDING are registered and fused. Each RECORDING becomes a trial, in the order given.
    """
    from studies.fusion.fuse import as_json as fused_as_json
    from studies.fusion.fuse import fuse_all

    with counted("fused", "frames") as shown:
        reports = fuse_all(
            recordings,
            output,
            points=points,
            per_frame=per_frame,
            convention=convention,
            skip_bad=skip_bad,
            seed=seed,
            force=force,
            progress=shown,
        )
    lines = []
    for report in reports:
        worst = max(sensor.residual_mm for sensor in report.sensors)
        of = "" if len(recordings) == 1 else f" of {report.recording}"
        lines.append(
            f"{output}: {report.frames} frames{of}, {len(report.sensors)} sensors within {worst:.2f} mm RMS of the "
            "cloth"
        )
        lines += [f"skipped: {what}" for what in report.skipped]
    print_result(fused_as_json(reports, len(recordings)), "\n".join(lines), as_json)


@commands.command()
@click.argument("sources", nargs=-1, required=True, type=FILE, metavar="SET...")
@click.option(
    "--fit",
    help="What to fit, separated by commas: trials by their order in the session, or records of a bench by name; by "
    "default all of role fit.",
)
@click.option(
    "--free",
    help="Effects to fit too, separated by commas: NAME, NAME.PARAMETER, NAME:PARAMETER=VALUE (not fitted); all: the "
    "strengths of every effect.",
)
@click.option("--fix", "fixed", help="Declared parameters to hold, separated by commas.")
@click.option(
    "--model",
    type=FILE,
    help="A model file. Its effects are kept. The fit starts at its factors; --fix holds them.",
)
@effects_option
@skip_bad_option
@click.option("--seed", type=SEED, default=0, show_default=True, help="Seed of the points and frames drawn.")
@click.option(
    "--grid",
    type=GRID,
    default=41,
    show_default=True,
    help="Grid points per side of the last step and of the model; the steps before take 21.",
)
@cluster_option
@click.option(
    "-o",
    "--output",
    type=OutputPath(".toml"),
    required=True,
    help="The model, or for a bench the muscle type or cloth, to write (TOML).",
)
@force_option
@json_option
def calibrate(
    sources: tuple[Path, ...],
    fit: str | None,
    free: str | None,
    fixed: str | None,
    model: Path | None,
    skip_bad: bool,
    seed: int,
    grid: int,
    output: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Fit a model to measurement sets, or a bench's law.

    The model's parameters are factors on the values of the data sheet. They are fitted to all sets together. --fit
    applies to each SET. A bench is a folder with bench.toml; two strips, cut across and down, become one cloth.
    """
    from fabdesign.bench_file import is_bench

    benches = [source for source in sources if is_bench(source)]
    if benches:
        from fabdesign.cli.benches import calibrate_benches

        if len(benches) < len(sources):
            raise InputError(f"{benches[0]}: a bench; expected benches alone, or measurement sets")
        if fixed is not None or model is not None:
            raise InputError("--fix and --model: of a measurement set; expected --free or --fit of a bench")
        calibrate_benches(benches, output, fit=fit, free=free, force=force, as_json=as_json)
        return
    from fabdesign import interface
    from studies.calibration.calibrate import orders_of
    from studies.calibration.report import as_text

    with described("calibrating") as shown:
        calibrated = interface.calibrate(
            sources,
            output,
            fit=None if fit is None else orders_of(fit),
            free=free.split(",") if free else (),
            fix=fixed.split(",") if fixed else (),
            model=model,
            skip_bad=skip_bad,
            grid=grid,
            seed=seed,
            force=force,
            progress=shown,
            say=tell,
        ).found
    then, why = _after_calibration(
        sources, output, sum(t.role == "fit" for s in calibrated.data.sets for t in s.trials)
    )
    text = f"{output}: {as_text(calibrated)}\nnext: {then} ({why})"
    print_result(calibrated.as_json() | {"model": str(output), "next": then}, text, as_json)


def _after_calibration(sources: Sequence[Path], output: Path, trials: int) -> tuple[str, str]:
    """Return the command that comes next, and why. trials: of role `fit`; a trace takes one set with several."""
    from studies.tracing.run import LEAST_TRIALS

    named = " ".join(map(str, sources))
    if len(sources) == 1 and trials >= LEAST_TRIALS:
        return f"fabdesign trace {named} --model {output} -o traced", "which effect the model lacks, if any"
    return f"fabdesign evaluate {named} --model {output} --all", "the errors before and after"


@commands.command()
@click.argument("design", type=FILE)
@click.argument("more", nargs=-1, metavar="[P.csv]... [DESIGN P.csv...]...")
@click.option("--pressures", multiple=True, help="Pressures of the first design, one file per trial.")
@click.option("--key", type=FILE, help="Ground truth of the specimen; not written into the set.")
@click.option("--recording", type=FILE, help="Folder for the raw clouds of four depth cameras, of the first trial.")
@click.option(
    "--test-trials", type=int, default=0, show_default=True, help="Number of last trials that get the role test."
)
@cluster_option
@click.option("-o", "--output", type=FOLDER, required=True, help="The measurement set to write.")
@force_option
@json_option
def rig(
    design: Path,
    more: tuple[str, ...],
    pressures: tuple[str, ...],
    key: Path | None,
    recording: Path | None,
    test_trials: int,
    output: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Measure a DESIGN on a virtual rig.

    The rig is another simulator than that of `simulate`. It writes a measurement set. Several designs share one
    session; each is followed by its pressures: A.toml P1.csv P2.csv B.toml P3.csv.
    """
    from studies.rig import run_rig

    (_, programs), *others = session = _session(design, pressures, more)
    with counted("measured") as shown:
        run_rig(
            design,
            programs,
            more=others,
            out=output,
            truth=key,
            recording=recording,
            test_trials=test_trials,
            force=force,
            progress=shown,
            say=tell,
        )
    trials = sum(len(own) for _, own in session)
    recorded = None if recording is None else str(recording)
    result = {"set": str(output), "trials": trials, "recording": recorded}
    print_result(result, f"{output}: {trials} trials of a synthetic rig", as_json)


def _session(first: Path, pressures: tuple[str, ...], more: tuple[str, ...]) -> list[tuple[Path, list[str]]]:
    """Each design with its pressures, those that follow it. Raises InputError."""
    session = [(first, [*pressures])]
    for given in more:
        if given.lower().endswith(".toml"):
            session.append((Path(given), []))
        else:
            session[-1][1].append(given)
    for design, own in session:
        if not own:
            raise InputError(
                f"{design}: no pressures; expected a program after it, or --pressures for the first design"
            )
    return session
