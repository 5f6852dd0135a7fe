"""What a model says of measured sets: the motions that it predicts, and how far they are off."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from fabdesign.effort import evaluation_seconds, in_words, on_cores
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
)
from fabdesign.interface.results import Evaluated, Motion
from fabdesign.model import Model
from fabdesign.output import new_folder
from fabdesign.trial import MeasurementSet, Role, Trial


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
    from studies.forward_model import extrapolated, not_corrected
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
        asked = [trial for trial in trials if trial.role in roles]
        for line in not_corrected(fitted, (trial.design for trial in asked)):
            say(line)
        for line in extrapolated(fitted, [trial.program for trial in asked]):
            say(line)
        motion = [float(trial.times[-1]) for trial in asked]
        seconds = evaluation_seconds(motion)
        if asked:  # else it is an error, in one line
            progress(in_words(seconds, f"{len(asked)} trials", on_cores()), None)
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

    out: a folder to which they are written, as OUT/trials/NAME.npz; then their files are what is returned. Of a model
    that has intervals a motion has its band, the file as `band90`.
    without: parts of the model that are left out. grid: as in `evaluate`. After Ctrl-C, without `out`, the motions that
    are done, with a warning.
    """
    from studies.coarser_grid import enough_points
    from studies.forward_model import extrapolated, not_corrected
    from studies.predict import folders_of, predicted, trials_of
    from studies.predict import predict as predict_trials
    from studies.sensitive_stretches import GRID as COARSE

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
        for line in not_corrected(fitted, (trial.design for trial in trials)):
            say(line)
        for line in extrapolated(fitted, [trial.program for trial in trials]):
            say(line)
        forward = simulator(grid) if grid else enough_points(fitted, trials, simulator, tell=say)
        coarse = simulator(COARSE) if fitted.spread is not None else None
        try:
            for folder, some in sets.items():
                if unfinished is not None:
                    place = unfinished / folder
                    predict_trials(forward, fitted, some, place, coarse=coarse, progress=lambda *_: count())
                    continue
                for trial, motion in predicted(forward, fitted, some, coarse=coarse):
                    motions[_name(folder, trial)] = Motion(motion.time, motion.points, motion.band)
                    count()
        except KeyboardInterrupt:
            if not motions:
                raise
            say(f"interrupted, with the first {len(motions)} of {len(trials)} trials")
    if out is None:
        return motions
    return [Path(out) / folder / "trials" / t.file.name for folder, some in sets.items() for t in some]


def _model(model: ModelLike, without: Sequence[str], say: Say) -> Model:
    fitted = one_model(model, without, say)
    if fitted is None:
        raise InputError("model: None; expected a model or its file")
    return fitted


def _name(folder: str, trial: Trial) -> str:
    return trial.name if folder == "." else f"{folder}/{trial.name}"


@contextmanager
def _folder(out: Path | str | None, made_by: str, force: bool, inputs: Sequence[Path]) -> Iterator[Path | None]:
    if out is None:
        yield None
        return
    with new_folder(Path(out), made_by=made_by, force=force, inputs=inputs) as unfinished:
        yield unfinished
