"""Fits to measured sets and benches: a model's factors, and a corrector that learns what the simulator leaves out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

from fabdesign.errors import InputError
from fabdesign.interface.run import Run, all_sets, benches_of, paths_of, simulator
from fabdesign.interface.verb import Computing, ModelLike, SetLike, Shown, Toml, verb
from fabdesign.units import in_mm

if TYPE_CHECKING:
    from fabdesign.nouns.model import Model
    from fabdesign.nouns.trial import MeasurementSet
    from optimize.fit.parameters import FitVector
    from studies.benches.calibrate import BenchCalibration
    from studies.training.train import HeldOutErrors, TrainingResult


def _calibrated(result: Any, given: Mapping[str, Any]) -> Shown:
    out, sources = given["out"], given["measured"]
    if isinstance(result, list):
        from studies.benches.calibrate import effects_in_words, errors_in_words, next_step, noise_in_words

        contents = [one.to_json() for one in result]
        files, lines = [str(Path(out).with_name(name)) for name in result[0].files], []
        for one in result:
            lines.append(f"{files[0]}: {one.bench.name}, {errors_in_words(one)}")
            lines += [*noise_in_words(one), *effects_in_words(one)]
        content = contents[0] if len(contents) == 1 else {"benches": contents}
        return Shown(content | {"files": files}, "\n".join([*lines, f"next: {next_step(result[0], Path(out))}"]))
    from fabdesign.nouns.trial import LEAST_TRIALS
    from studies.calibration.result import as_text

    named, trials = " ".join(map(str, sources)), [t for s in result.data.sets for t in s.trials if t.role == "fit"]
    then, why = f"fabdesign evaluate {named} --model {out} --all", "the errors before and after"
    if len(sources) == 1 and len(trials) >= LEAST_TRIALS:
        then, why = f"fabdesign trace {named} --model {out} -o traced", "which effect the model lacks, if any"
    text = f"{out}: {as_text(result)}\nnext: {then} ({why})"
    return Shown(result.to_json() | {"model": str(out), "next": then}, text)


@verb(_calibrated, "SET...", title="calibrating")
def calibrate(
    measured: SetLike | Sequence[SetLike],
    out: Toml | None = None,
    *,
    fit: Sequence[str | int] | None = None,
    free: Sequence[str] = (),
    fix: Sequence[str] = (),
    model: ModelLike | None = None,
    skip_bad: bool = False,
    seed: int = 0,
    grid: int = 41,
    **given: Unpack[Computing],
) -> Any:
    """Fit a model to measurement sets, or a bench's law.

    The model's parameters are factors on the values of the data sheet. They are fitted to all sets together. --fit
    applies to each SET. A bench is a folder with bench.toml; two strips, cut across and down, become one cloth.

    out: The model, or for a bench the muscle type or cloth, to write (TOML).
    fit: What to fit, separated by commas: trials by their order in the session, or records of a bench by name; by
        default all of role fit.
    free: Effects to fit too, separated by commas: NAME, NAME.PARAMETER, NAME:PARAMETER=VALUE (not fitted); all: the
        strengths of every effect.
    fix: Declared parameters to hold, separated by commas.
    model: A model file. Its effects are kept. The fit starts at its factors; --fix holds them.
    seed: Seed of the points and frames drawn.
    grid: Grid points per side of the last step and of the model; the steps before take 21.

    Returns a `Calibration`, whose `.model` is what came out; of benches a list of `BenchCalibration`. After Ctrl-C its
    values are those reached so far, with a warning. Raises InputError for an unsound set, SimulationError where all
    motions diverge.
    """
    run = Run(**given)
    if benches := benches_of(measured):
        if fix or model is not None:
            raise InputError("--fix and --model: of a measurement set; expected --free or --fit of a bench")
        return _calibrate_benches(run, benches, out, fit, free)
    from fabdesign.files.model_file import write_model
    from fabdesign.nouns.model import Model
    from fabdesign.runtime.effort import CALIBRATION, fit_in_words, fit_seconds
    from studies.calibration.calibrate import DRAWN, CalibrationOptions, calibrate_sets, orders_of
    from studies.measured.used_frames import GRID as COARSE

    orders = None if fit is None else orders_of(",".join(map(str, fit)))
    sets, skipped = run.sound(all_sets(measured), skip_bad=skip_bad)
    base = run.model(model) or Model()
    vector = unknowns_of(free, fix, base, sets)
    taken = [t for one in sets for t in one.trials if (t.role == "fit" if orders is None else t.order in orders)]
    motion = [min(t.times[-1], DRAWN.until) for t in taken]
    seconds = fit_seconds(CALIBRATION, motion, len(vector.parameters), grid)
    with run.file(out, paths_of(measured, model)) as unfinished, run.computing():
        run.progress(fit_in_words(len(motion), len(vector.parameters), seconds), None)
        calibration = calibrate_sets(
            sets, simulator(grid), vector=vector, progress=run.progress,
            options=CalibrationOptions(
                slopes=simulator(min(grid, COARSE)), coarse=simulator(COARSE), points_per_side=grid, orders=orders,
                skipped=skipped, skip_bad=skip_bad, seed=seed, intervals=True, interruptible=True,
            ),
        )  # fmt: skip
        if base.learned_range is not None and calibration.model.learned_range is None:  # what was learned is held
            calibration = replace(calibration, model=replace(calibration.model, learned_range=base.learned_range))
        if unfinished is not None:
            write_model(calibration.model, unfinished)
    if calibration.fit.interrupted:
        run.say(f"interrupted after {calibration.fit.iterations} iterations; the values are those reached so far")
    return calibration


def _calibrate_benches(
    run: Run, benches: Sequence[Path], out: Toml | None, fit: Sequence[str | int] | None, free: Sequence[str]
) -> list[BenchCalibration]:
    """Fit each bench; write one file, of several strips a cloth."""
    from fabdesign.files.bench_file import read_bench
    from studies.benches.calibrate import calibrate_bench
    from studies.benches.write import require_one_cloth, write_bench_type, write_cloth

    if len(benches) > 1:
        require_one_cloth([read_bench(bench) for bench in benches])
    with run.file(out, benches) as unfinished:
        names = None if fit is None else [*map(str, fit)]
        fitted = [calibrate_bench(bench, fit=names, free=free, progress=run.progress) for bench in benches]
        if unfinished is None:
            return fitted
        written = write_cloth(fitted, unfinished) if len(fitted) > 1 else write_bench_type(fitted[0], unfinished)
        return [replace(one, files=tuple(file.name for file in written)) for one in fitted]


def unknowns_of(free: Sequence[str], fix: Sequence[str], base: Model, sets: Sequence[MeasurementSet]) -> FitVector:
    """Return what a fit of these sets moves. Raises InputError."""
    from optimize.fit.free_parameters import fit_vector

    designs = [design for one in sets for design in one.designs.values()]
    return fit_vector(free, fix, factors=base.factors, terms=base.terms, designs=designs)


def _trained(result: TrainingResult, given: Mapping[str, Any]) -> Shown:
    """Return what was learned from what, and what it is worth on trials that took no part."""
    out = Path(given["out"])
    content = {"model": str(out), "weights": str(out.with_suffix(".safetensors")), "skipped": [*result.skipped]}
    lines = [
        f"{out}: {result.about['network']} corrector on {result.base}, {result.learned_from} trials learned from"
        + ("" if result.held_out else "; no trial was held out, so nothing says what it is worth")
    ]
    lines += [_line(name, of, ordered=result.about["network"] == "field") for name, of in result.held_out.items()]
    for one in result.about["left_out"]:
        lines.append(
            f"design {one['design']} left out: {one['before_mm']:.2f} to {one['after_mm']:.2f} mm along the normal, "
            f"at a distance of {one['distance']:.2f}"
        )
    if result.about["network"] == "field":
        lines.append(
            f"designs farther than {result.about['trust_limit']:.2f} from those learned from are not corrected"
        )
    lines.append(result.intervals)
    if result.used.stretches is not None:
        lines.append(result.used.in_words)
    lines += [f"skipped: {line}" for line in result.skipped]
    return Shown(result.to_json() | content, "\n".join(lines))


def _line(name: str, of: HeldOutErrors, *, ordered: bool) -> str:
    before, after = of.before, of.after
    trials = f"{of.trials} trial{'s' * (of.trials != 1)} of {name} held out"
    if not ordered:
        return (
            f"{trials}: Chamfer {in_mm(before.chamfer):.2f} to {in_mm(after.chamfer):.2f} mm (floor "
            f"{in_mm(before.chamfer_floor):.2f})"
        )
    share = "" if of.closed.surface is None else f", {of.closed.surface:.0%} of the excess error removed"
    far = "" if of.trust.applies else f"; {of.trust.distance:.2f} from what was learned, too far: not corrected"
    sheet = "" if of.sheet is None else f"data sheet {in_mm(of.sheet.surface_rms):.2f}, base and corrector "
    return (
        f"{trials}: surface RMS {sheet}{in_mm(before.surface_rms):.2f} to {in_mm(after.surface_rms):.2f} mm (floor "
        f"{in_mm(after.surface_floor):.2f}){share}{far}"
    )


@verb(_trained, "SETS...", title="training")
def train(
    measured: SetLike | Sequence[SetLike],
    out: Toml,
    *,
    network: Literal["field", "paper"] = "field",
    hold_out: Sequence[str] = (),
    model: ModelLike | None = None,
    free: Sequence[str] = (),
    skip_bad: bool = False,
    seed: int = 0,
    grid: int | None = None,
    **given: Unpack[Computing],
) -> TrainingResult:
    """Train a corrector on measured SETS.

    The corrector learns what the simulator leaves out. The same command continues after a stop.

    out: The model to write (TOML); its weights are written beside it.
    network: field: moves the points of the simulator; paper: the network of Peng et al., which gives an unordered
        cloud.
    hold_out: A design whose trials are not used for training.
    model: A model file with the parameters of the motions; by default the data sheet.
    free: Effects to fit before the training, with the declared parameters and to the same trials, as with
        `calibrate --free`; all: the strengths of every effect.

    The network of the paper needs the extra `corrector`. After Ctrl-C the same call goes on.
    """
    if network == "paper":
        import corrector.paper_training  # noqa: F401 loads PyTorch: without it nothing is begun
    from fabdesign.nouns.model import Model
    from fabdesign.output import new_files
    from fabdesign.runtime.effort import CALIBRATION, TRAINING, fit_seconds, in_words, on_cores, trials_seconds
    from studies.measured.used_frames import GRID as COARSE
    from studies.training.data import TrainingOptions
    from studies.training.train import train_on

    run, out = Run(**given), Path(out)
    base = run.model(model) or Model()
    sets, skipped = run.sound(all_sets(measured), skip_bad=skip_bad)
    base = replace(base, points_per_side=grid or base.points_per_side)
    vector = unknowns_of(free, (), base, sets) if free else None
    motion = [float(t.times[-1]) for one in sets for t in one.trials if t.role == "fit"]
    seconds = trials_seconds(TRAINING, motion)
    if vector is not None:
        seconds += fit_seconds(CALIBRATION, motion, len(vector.parameters), base.points_per_side)
    # how long the paper's takes is its plan's
    estimate = in_words(seconds, f"{len(motion)} trials", on_cores()) if motion and network == "field" else None
    show = run.opened(lambda: estimate)
    beside = out.with_suffix(".safetensors").name
    places = new_files(out, companions=[beside], force=run.force, inputs=paths_of(measured, model))
    with places as unfinished, run.computing():
        options = TrainingOptions(
            base=base,
            vector=vector,
            slopes=simulator(min(base.points_per_side, COARSE)),
            network=network,
            hold_out=tuple(hold_out),
            seed=seed,
            coarse=simulator(COARSE),
        )
        result = train_on(
            sets,
            simulator(base.points_per_side),
            unfinished,
            options,
            goes_to=out,
            force=run.force,
            progress=lambda what, done, of: show(f"{what} {done} of {of}", done / of),
        )
    return replace(result, skipped=tuple(skipped))
