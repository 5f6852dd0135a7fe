"""Models beside measured data: the motions that they predict, how far they are off, and which effect they lack."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from fabdesign.errors import InputError
from fabdesign.interface.fits import unknowns_of
from fabdesign.interface.run import Run, all_sets, benches_of, paths_of, several, simulator, work_folder
from fabdesign.interface.verb import Computing, DesignLike, Folder, ModelLike, SetLike, Shown, verb

if TYPE_CHECKING:
    from fabdesign.files.motion_file import Motion
    from fabdesign.nouns.trial import Role
    from studies.benches.evaluate import BenchEvaluation


def _evaluated(result: Any, given: Mapping[str, Any]) -> Shown:
    if hasattr(result, "as_markdown"):  # of a bench
        return Shown(result, result.as_markdown())
    from studies.prediction.evaluation_report import tables_markdown

    text = "\n".join([tables_markdown(result), *(f"skipped: {line}" for line in result.skipped)])
    return Shown(result.to_json() | {"skipped": [*result.skipped]}, text)


@verb(_evaluated, "SETS...", optional=True, title="evaluating")
def evaluate(
    measured: SetLike | Sequence[SetLike],
    model: ModelLike,
    out: Folder | None = None,
    *,
    without: Sequence[str] = (),
    all_trials: bool = False,
    skip_bad: bool = False,
    grid: int | None = None,
    **given: Unpack[Computing],
) -> Any:
    """Print the error of a model on measured SETS, in mm.

    "Before" is the model without effects and corrector, or the data sheet. "After" is the whole model. Trials of role
    test are evaluated: nothing was fitted to them. SETS can also be one bench (a folder with bench.toml); its model is
    the file that calibrate wrote.

    model: A model file; for a bench the file that calibrate wrote.
    out: A folder for tables, a picture and the whole result.
    all_trials: Evaluate trials of role fit too, in a second table.

    Returns a `SetEvaluation`, of a bench a `BenchEvaluation`. After Ctrl-C the trials that are done, with a warning.
    Raises InputError where no trial is left.
    """
    run = Run(**given)
    roles: tuple[Role, ...] = ("test", "fit") if all_trials else ("test",)
    if benches := benches_of(measured):
        if len(benches) > 1:
            raise InputError(f"{benches[0]}: a bench among {len(benches)} sources; expected a bench alone, or sets")
        return _evaluate_bench(run, benches[0], model, out, roles)
    from fabdesign.runtime.effort import EVALUATION, in_words, on_cores, trials_seconds
    from studies.measured.used_frames import GRID as COARSE
    from studies.prediction.evaluate import evaluate_sets
    from studies.prediction.evaluation_report import write_evaluation
    from studies.prediction.forward_model import enough_points, forward_model

    fitted = run.known_model(model, without)
    sets, skipped = run.sound(all_sets(measured), skip_bad=skip_bad, roles=roles)
    with run.folder(out, "evaluate", paths_of(measured, model)) as unfinished, run.computing():
        trials = [trial for one in sets for trial in one.trials]
        asked = [trial for trial in trials if trial.role in roles]
        run.warn_beyond(fitted, [trial.program for trial in asked], asked)
        seconds = trials_seconds(EVALUATION, [float(trial.times[-1]) for trial in asked])
        if asked:  # else it is an error, in one line
            run.progress(in_words(seconds, f"{len(asked)} trials", on_cores()), None)
        forward = simulator(grid) if grid else enough_points(fitted, trials, simulator, tell=run.say)
        evaluation = evaluate_sets(
            forward_model(forward, fitted),
            sets,
            coarse=simulator(COARSE),
            roles=roles,
            on_interrupt="end",
            progress=lambda done, of: run.progress(f"evaluated {done} of {of} trials", done / of),
        )
        if (done := len(evaluation.rows)) < len(asked):
            run.say(f"interrupted, with the first {done} of {len(asked)} trials")
        if unfinished is not None:
            write_evaluation(evaluation, unfinished)
    return replace(evaluation, skipped=tuple(skipped))


def _evaluate_bench(run: Run, bench: Path, law: Any, out: Folder | None, roles: Sequence[Role]) -> BenchEvaluation:
    from fabdesign.formats.json_file import write_json
    from fabdesign.output import write_text
    from studies.benches.evaluate import evaluate_bench

    if not isinstance(law, Path | str):
        raise InputError("model: a model of a bench; expected the file that calibrate wrote")
    evaluation = evaluate_bench(bench, Path(law), roles)
    with run.folder(out, "evaluate", [bench, Path(law)]) as unfinished:
        if unfinished is not None:
            write_json(unfinished / "evaluation.json", evaluation)
            write_text(unfinished / "evaluation.md", evaluation.as_markdown() + "\n")
    return evaluation


def _predicted(result: Sequence[Path], given: Mapping[str, Any]) -> Shown:
    from fabdesign.files.motion_file import read_band
    from fabdesign.units import in_mm
    from studies.intervals.calibrate import mean_width, width_in_words

    bands = [band for file in result if (band := read_band(file)) is not None]
    width = in_mm(mean_width(bands)) if bands else None
    lines = [f"{given['out']}: {len(result)} motions", *([width_in_words(bands)] if bands else [])]
    return Shown({"motions": [str(file) for file in result], "interval_width_mm": width}, "\n".join(lines))


@verb(_predicted, "SET...", title="predicting")
def predict(
    measured: SetLike | Sequence[SetLike],
    model: ModelLike,
    out: Folder | None = None,
    *,
    without: Sequence[str] = (),
    design: DesignLike | None = None,
    grid: int | None = None,
    **given: Unpack[Computing],
) -> dict[str, Motion] | list[Path]:
    """Predict the motion of every trial of a SET.

    SET can also be a single TRIAL.npz. Each motion has the times of its trial. The command writes
    OUTPUT/trials/NAME.npz, for several sets OUTPUT/SET/trials/NAME.npz.

    model: A model file.
    design: Design of a single trial file.

    With `out` the files are what is returned; else motions by name, of several sets SET/NAME, sensing effects included,
    each with its band where the model has intervals. After Ctrl-C, without `out`, those that are done, with a warning.
    """
    from fabdesign.interface.arguments import one_design
    from fabdesign.nouns.trial import MeasurementSet
    from studies.measured.used_frames import GRID as COARSE
    from studies.prediction.forward_model import enough_points
    from studies.prediction.predict import folders_of, predicted, trials_of
    from studies.prediction.predict import predict as predict_trials

    run = Run(**given)
    fitted = run.known_model(model, without)
    loaded = None if design is None else one_design(design)
    many = several("measurement sets", measured, MeasurementSet)
    sets = folders_of([trials_of(one if isinstance(one, MeasurementSet) else Path(one), loaded) for one in many])
    trials = [trial for some in sets.values() for trial in some]
    motions: dict[str, Motion] = {}
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        run.progress(f"predicted {done} of {len(trials)} trials", done / len(trials))

    with run.folder(out, "predict", paths_of(measured, model, design)) as unfinished, run.computing():
        run.warn_beyond(fitted, [trial.program for trial in trials], trials)
        forward = simulator(grid) if grid else enough_points(fitted, trials, simulator, tell=run.say)
        coarse = simulator(COARSE) if fitted.spread is not None else None
        try:
            for folder, some in sets.items():
                if unfinished is not None:
                    place = unfinished / folder
                    predict_trials(forward, fitted, some, place, coarse=coarse, progress=lambda *_: count())
                    continue
                for trial, motion in predicted(forward, fitted, some, coarse=coarse):
                    name = trial.name if folder == "." else f"{folder}/{trial.name}"
                    motions[name] = motion
                    count()
        except KeyboardInterrupt:
            if not motions:
                raise
            run.say(f"interrupted, with the first {len(motions)} of {len(trials)} trials")
    if out is None:
        return motions
    return [Path(out) / folder / "trials" / t.file.name for folder, some in sets.items() for t in some]


def _traced(result: Any, given: Mapping[str, Any]) -> Shown:
    from studies.benches import trace_report as of_bench
    from studies.tracing import report as of_set

    as_text = of_bench.as_text if hasattr(result, "bench") else of_set.as_text
    return Shown(result, f"{given['out']}: {as_text(result)}")


def _share_or_metres(given: dict[str, Any]) -> None:
    """Read a tolerance in % of a bench, in mm of a set."""
    from fabdesign.units import from_mm

    if (tolerance := given.get("tolerance")) is not None:
        given["tolerance"] = tolerance / 100 if benches_of(given["measured"]) else from_mm(tolerance)


@verb(_traced, "SET|BENCH", from_shell=_share_or_metres, title="tracing")
def trace(
    measured: SetLike,
    out: Folder | None = None,
    *,
    model: ModelLike | None = None,
    tolerance: float | None = None,
    grid: int | None = None,
    seed: int = 0,
    **given: Unpack[Computing],
) -> Any:
    """Find which effect the model of measured data lacks.

    The data are a measurement SET or a BENCH. The effects are chosen by model selection. The answer can be that no
    effect is missing, or that none of the known effects explains the data.

    out: Folder to write to, or to continue in.
    model: A model file: start of the fit, and effects that are already known.
    tolerance: Excess error on held-out trials that is accepted: in mm, by default 0.5; for a bench in % of its output,
        by default 2.
    grid: Grid points per side; by default 21, or 41 where 21 are too coarse.
    seed: Seed of the points drawn.

    In Python the tolerance is in m, of a bench a share. Returns an `Outcome`: `.verdict`, `.model`; of a bench a
    `BenchOutcome`. Without `out` nothing is kept; with it the same call goes on after Ctrl-C.
    """
    run = Run(**given)
    if benches := benches_of(measured):
        from studies.benches import tracing as of_bench

        share = of_bench.TOLERANCE if tolerance is None else tolerance
        with work_folder(out) as folder:
            return of_bench.trace_bench(benches[0], folder, tolerance=share, force=run.force, progress=run.progress)
    from fabdesign.nouns.model import Model
    from fabdesign.runtime.effort import TRACE, Pace, fit_in_words, fit_seconds
    from studies.fitting.fitted_model import EXCESS
    from studies.measured.splits import TRIALS
    from studies.measured.used_frames import GRID
    from studies.model_selection.verdict import SO_FAR
    from studies.tracing.run import DRAWN, Options, trace_set

    fitted, sets = run.model(model), all_sets(measured)
    if len(sets) != 1:
        raise InputError(f"{len(sets)} measurement sets; expected one")
    (sound,), _ = run.sound(sets, skip_bad=False)
    motion = [min(t.times[-1], DRAWN.until) for t in sound.trials if t.role == "fit"][:TRIALS]
    unknowns = len(unknowns_of(["all"], (), fitted or Model(), [sound]).parameters)
    seconds = fit_seconds(TRACE, motion, unknowns, grid or GRID)
    pace, show = Pace(seconds), run.opened(lambda: fit_in_words(len(motion), unknowns, seconds))
    with work_folder(out) as folder, run.computing():
        return trace_set(
            sound,
            folder,
            inputs=paths_of(measured, model),
            options=Options(EXCESS if tolerance is None else tolerance, grid, seed, fitted),
            force=run.force,
            say=lambda line: show(line, None if line.startswith(SO_FAR) else pace.share()),
        )
