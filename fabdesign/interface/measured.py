"""What is done with measured sets: calibrate, train, predict, evaluate, find what is missing."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from fabdesign.errors import InputError
from fabdesign.interface.arguments import (
    DesignLike,
    ModelLike,
    Progress,
    Say,
    SetLike,
    all_sets,
    computing,
    one_design,
    one_model,
    paths_of,
    simulator,
    unheard,
    warn,
    work_folder,
)
from fabdesign.interface.results import Calibrated, Evaluated, Motion, Traced, Trained
from fabdesign.model import POINTS_PER_SIDE, Model
from fabdesign.model_file import write_model
from fabdesign.output import new_file, new_files, new_folder
from fabdesign.trial import MeasurementSet, Role, Trial

FINE = 61  # points a side of a calibration


def calibrate(
    measured: SetLike | Sequence[SetLike],
    out: Path | str | None = None,
    *,
    fit: Sequence[int] | None = None,
    free: Sequence[str] = (),
    fix: Sequence[str] = (),
    model: ModelLike | None = None,
    skip_bad: bool = False,
    grid: int = FINE,
    seed: int = 0,
    force: bool = False,
    progress: Progress = unheard,
    say: Say = warn,
    cluster: str | None = None,
) -> Calibrated:
    """Declared parameters, and what `free` adds, fitted to measurement sets together; `.model` is what came out.

    out: a model file to write. fit: orders of the trials to fit in each set, by default all of role `fit`. free:
    effects to fit besides, as `calibrate --free` names them; fix: declared parameters that are held. model: what holds
    besides, and where the others begin. skip_bad: leave out unsound trials. grid: points a side. After Ctrl-C the
    values reached so far, with a warning. Raises InputError for an unsound set, SimulationError where all motions
    diverge.
    """
    from optimize.fit.parameters import fit_vector
    from studies.bad_data import sound_trials
    from studies.calibration.calibrate import calibrate as calibrate_sets
    from studies.calibration.fitted_model import muscle_scope
    from studies.sensitive_stretches import GRID as COARSE

    checked = [sound_trials(read, skip_bad=skip_bad) for read in all_sets(measured)]
    base = one_model(model, say=say) or Model()
    designs = [design for read, _ in checked for design in read.designs.values()]
    vector = fit_vector(
        free,
        fix,
        factors=base.factors,
        terms=base.terms,
        scope=muscle_scope(designs),
        channels=max(design.channels for design in designs),
        size=(designs[0].fabric.width, designs[0].fabric.height),
    )
    with _file(out, force, paths_of(measured, model)) as unfinished, computing(cluster):
        calibration = calibrate_sets(
            [sound for sound, _ in checked],
            simulator(grid),
            slopes=simulator(min(grid, POINTS_PER_SIDE)),
            coarse=simulator(COARSE),
            vector=vector,
            points_per_side=grid,
            orders=fit,
            skipped=[line for _, lines in checked for line in lines],
            skip_bad=skip_bad,
            seed=seed,
            interruptible=True,
            progress=progress,
        )
        if unfinished is not None:
            write_model(calibration.model, unfinished)
    if calibration.fit.interrupted:
        say(f"interrupted after {calibration.fit.iterations} iterations; the values are those reached so far")
    return Calibrated(calibration)


def evaluate(
    model: ModelLike,
    measured: SetLike | Sequence[SetLike],
    out: Path | str | None = None,
    *,
    without: Sequence[str] = (),
    all_trials: bool = False,
    skip_bad: bool = False,
    grid: int | None = None,
    force: bool = False,
    progress: Progress = unheard,
    say: Say = warn,
    cluster: str | None = None,
) -> Evaluated:
    """How far a model's motions are from the measured ones, before and after, on the trials of role `test`.

    out: a folder for tables, a picture and the whole result. without: parts of the model that are left out. all_trials:
    those of role `fit` too, in a table of their own. grid: points a side, by default the model's, or 41 where they are
    enough. After Ctrl-C the trials that are done, with a warning. Raises InputError where no trial is left.
    """
    from studies.bad_data import sound_trials
    from studies.coarser_grid import enough_points
    from studies.evaluate import evaluate_sets
    from studies.evaluation_report import write_evaluation
    from studies.sensitive_stretches import GRID as COARSE

    fitted = _model(model, without, say)
    roles: tuple[Role, ...] = ("test", "fit") if all_trials else ("test",)
    checked = [sound_trials(read, skip_bad=skip_bad, roles=roles) for read in all_sets(measured)]
    sets = [sound for sound, _ in checked]
    done, of = 0, 0

    def count(now: int, of_all: int) -> None:
        nonlocal done, of
        done, of = now, of_all
        progress(f"evaluated {done} of {of} trials", done / of)

    with _folder(out, "evaluate", force, paths_of(measured, model)) as unfinished, computing(cluster):
        trials = [trial for read in sets for trial in read.trials]
        forward = simulator(grid) if grid else enough_points(fitted, trials, simulator, tell=say)
        evaluation = evaluate_sets(
            fitted,
            sets,
            forward,
            coarse=simulator(COARSE),
            all_trials=all_trials,
            interruptible=True,
            progress=count,
        )
        if done < of:
            say(f"interrupted, with the first {done} of {of} trials")
        if unfinished is not None:
            write_evaluation(evaluation, unfinished)
    return Evaluated(evaluation, tuple(line for _, lines in checked for line in lines))


def predict(
    model: ModelLike,
    measured: SetLike | Sequence[SetLike],
    out: Path | str | None = None,
    *,
    without: Sequence[str] = (),
    design: DesignLike | None = None,
    grid: int | None = None,
    force: bool = False,
    progress: Progress = unheard,
    say: Say = warn,
    cluster: str | None = None,
) -> dict[str, Motion] | list[Path]:
    """The motion of every trial of measured sets, or of a lone trial's file with its `design`, at its own times, by
    name (of several sets SET/NAME), sensing effects included.

    out: a folder to which they are written, as OUT/trials/NAME.npz; then their files are what is returned.
    without: parts of the model that are left out. grid: as in `evaluate`. After Ctrl-C, without `out`, the motions that
    are done, with a warning.
    """
    from studies.coarser_grid import enough_points
    from studies.predict import folders_of, predicted, trials_of
    from studies.predict import predict as predict_trials

    fitted = _model(model, without, say)
    own = None if design is None else one_design(design)
    many = [measured] if isinstance(measured, MeasurementSet | Path | str) else measured
    sets = folders_of([trials_of(one if isinstance(one, MeasurementSet) else Path(one), own) for one in many])
    trials = [trial for some in sets.values() for trial in some]
    motions: dict[str, Motion] = {}
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        progress(f"predicted {done} of {len(trials)} trials", done / len(trials))

    with _folder(out, "predict", force, paths_of(measured, model, design)) as unfinished, computing(cluster):
        forward = simulator(grid) if grid else enough_points(fitted, trials, simulator, tell=say)
        try:
            for folder, some in sets.items():
                if unfinished is not None:
                    predict_trials(forward, fitted, some, unfinished / folder, progress=lambda *_: count())
                    continue
                for trial, motion in predicted(forward, fitted, some):
                    motions[_name(folder, trial)] = Motion(motion.time, motion.points)
                    count()
        except KeyboardInterrupt:
            if not motions:
                raise
            say(f"interrupted, with the first {len(motions)} of {len(trials)} trials")
    if out is None:
        return motions
    return [Path(out) / folder / "trials" / t.file.name for folder, some in sets.items() for t in some]


def train(
    measured: SetLike | Sequence[SetLike],
    out: Path | str,
    *,
    network: Literal["field", "paper"] = "field",
    hold_out: Sequence[str] = (),
    model: ModelLike | None = None,
    skip_bad: bool = False,
    seed: int = 0,
    grid: int | None = None,
    force: bool = False,
    progress: Progress = unheard,
    say: Say = warn,
    cluster: str | None = None,
) -> Trained:
    """A corrector that learns from measured sets what the simulator leaves out; the model `out`, its weights beside it.

    network: `field` moves the simulator's points; `paper`, the seed paper's, gives an unordered cloud (the extra
    `corrector`). hold_out: designs whose trials are not learned from. model: whose parameters the motions have. After
    Ctrl-C the same call goes on.
    """
    if network == "paper":
        import corrector.paper_training  # noqa: F401 loads PyTorch: without it nothing is begun
    from studies.bad_data import sound_trials
    from studies.sensitive_stretches import GRID as COARSE
    from studies.training.train import train as train_on

    base, out = one_model(model, say=say), Path(out)
    checked = [sound_trials(read, skip_bad=skip_bad) for read in all_sets(measured)]
    beside = out.with_suffix(".safetensors").name
    places = new_files(out, companions=[beside], force=force, inputs=paths_of(measured, model))
    with places as unfinished, computing(cluster):
        result = train_on(
            [sound for sound, _ in checked],
            simulator(grid or (base or Model()).points_per_side),
            unfinished,
            goes_to=out,
            base=base,
            network=network,
            hold_out=hold_out,
            seed=seed,
            force=force,
            coarse=simulator(COARSE),
            progress=lambda what, done, of: progress(f"{what} {done} of {of}", done / of),
        )
    return Trained(out, result, tuple(line for _, lines in checked for line in lines))


def trace(
    measured: SetLike,
    out: Path | str | None = None,
    *,
    model: ModelLike | None = None,
    tolerance: float | None = None,
    grid: int | None = None,
    seed: int = 0,
    force: bool = False,
    progress: Progress = unheard,
    say: Say = warn,
    cluster: str | None = None,
) -> Traced:
    """Which effect the model of a measured set lacks, or that none is missing: `.verdict`, `.model`.

    out: the folder to write to, or to go on in after Ctrl-C; without it nothing is kept. model: where the fit starts,
    and effects that are known already. tolerance: m of held-out excess, by default 0.0005. grid: points a side, by
    default 21, or 41 where 21 are too coarse.
    """
    from studies.bad_data import sound_trials
    from studies.tracing.run import TOLERANCE, Options, trace_set

    fitted = one_model(model, say=say)
    sets = all_sets(measured)
    if len(sets) != 1:
        raise InputError(f"{len(sets)} measurement sets; expected one")
    sound, _ = sound_trials(sets[0], skip_bad=False)
    options = Options(TOLERANCE if tolerance is None else tolerance, grid, seed)
    with work_folder(out) as folder, computing(cluster):
        outcome = trace_set(
            sound,
            folder,
            inputs=paths_of(measured, model),
            model=fitted,
            options=options,
            force=force,
            say=lambda line: progress(line, None),
        )
    return Traced(outcome)


def _model(model: ModelLike, without: Sequence[str], say: Say) -> Model:
    fitted = one_model(model, without, say)
    if fitted is None:
        raise InputError("model: None; expected a model or its file")
    return fitted


def _name(folder: str, trial: Trial) -> str:
    return trial.name if folder == "." else f"{folder}/{trial.name}"


@contextmanager
def _file(out: Path | str | None, force: bool, inputs: Sequence[Path]) -> Iterator[Path | None]:
    if out is None:
        yield None
        return
    with new_file(Path(out), force=force, inputs=inputs) as unfinished:
        yield unfinished


@contextmanager
def _folder(out: Path | str | None, made_by: str, force: bool, inputs: Sequence[Path]) -> Iterator[Path | None]:
    if out is None:
        yield None
        return
    with new_folder(Path(out), made_by=made_by, force=force, inputs=inputs) as unfinished:
        yield unfinished
