"""What measured sets teach: the factors of a model, the effects that it lacks, a corrector for the rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from fabdesign.effort import CALIBRATION, TRACE, Pace, fit_in_words, fit_seconds, in_words, on_cores, training_seconds
from fabdesign.errors import InputError
from fabdesign.interface.arguments import (
    ModelLike,
    Progress,
    Say,
    SetLike,
    all_sets,
    computing,
    one_model,
    paths_of,
    simulator,
    unheard,
    warn,
    work_folder,
)
from fabdesign.interface.results import Calibrated, Traced, Trained
from fabdesign.model import POINTS_PER_SIDE, Model
from fabdesign.model_file import write_model
from fabdesign.output import new_file, new_files
from fabdesign.trial import MeasurementSet

if TYPE_CHECKING:
    from optimize.fit.parameters import FitVector


def calibrate(
    measured: SetLike | Sequence[SetLike],
    out: Path | str | None = None,
    *,
    fit: Sequence[int] | None = None,
    free: Sequence[str] = (),
    fix: Sequence[str] = (),
    model: ModelLike | None = None,
    skip_bad: bool = False,
    grid: int = POINTS_PER_SIDE,
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
    from studies.bad_data import sound_trials
    from studies.calibration.calibrate import DRAWN
    from studies.calibration.calibrate import calibrate as calibrate_sets
    from studies.sensitive_stretches import GRID as COARSE

    checked = [sound_trials(read, skip_bad=skip_bad) for read in all_sets(measured)]
    base = one_model(model, say=say) or Model()
    vector = _unknowns(free, fix, base, [sound for sound, _ in checked])
    taken = [t for sound, _ in checked for t in sound.trials if (t.role == "fit" if fit is None else t.order in fit)]
    motion = [min(t.times[-1], DRAWN.until) for t in taken]
    seconds = fit_seconds(CALIBRATION, motion, len(vector.parameters), grid)
    with _file(out, force, paths_of(measured, model)) as unfinished, computing(cluster):
        progress(fit_in_words(len(motion), len(vector.parameters), seconds), None)
        calibration = calibrate_sets(
            [sound for sound, _ in checked],
            simulator(grid),
            slopes=simulator(min(grid, COARSE)),
            coarse=simulator(COARSE),
            vector=vector,
            points_per_side=grid,
            orders=fit,
            skipped=[line for _, lines in checked for line in lines],
            skip_bad=skip_bad,
            seed=seed,
            intervals=True,
            interruptible=True,
            progress=progress,
        )
        if base.learned_range is not None and calibration.model.learned_range is None:  # what was learned is held
            calibration = replace(calibration, model=replace(calibration.model, learned_range=base.learned_range))
        if unfinished is not None:
            write_model(calibration.model, unfinished)
    if calibration.fit.interrupted:
        say(f"interrupted after {calibration.fit.iterations} iterations; the values are those reached so far")
    return Calibrated(calibration)


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
    from studies.tracing.run import DRAWN, GRID, TOLERANCE, TRIALS, Options, trace_set
    from studies.tracing.verdict import SO_FAR

    fitted = one_model(model, say=say)
    sets = all_sets(measured)
    if len(sets) != 1:
        raise InputError(f"{len(sets)} measurement sets; expected one")
    sound, _ = sound_trials(sets[0], skip_bad=False)
    options = Options(TOLERANCE if tolerance is None else tolerance, grid, seed)
    motion = [min(t.times[-1], DRAWN.until) for t in sound.trials if t.role == "fit"][:TRIALS]
    unknowns = len(_unknowns(["all"], (), fitted or Model(), [sound]).parameters)
    seconds = fit_seconds(TRACE, motion, unknowns, grid or GRID)
    pace, opening = Pace(seconds), [fit_in_words(len(motion), unknowns, seconds)]

    def announce(line: str) -> None:
        while opening:  # once the folder is known to be free
            progress(opening.pop(), None)
        progress(line, None if line.startswith(SO_FAR) else pace.share())

    with work_folder(out) as folder, computing(cluster):
        outcome = trace_set(
            sound,
            folder,
            inputs=paths_of(measured, model),
            model=fitted,
            options=options,
            force=force,
            say=announce,
        )
    return Traced(outcome)


def train(
    measured: SetLike | Sequence[SetLike],
    out: Path | str,
    *,
    network: Literal["field", "paper"] = "field",
    hold_out: Sequence[str] = (),
    model: ModelLike | None = None,
    free: Sequence[str] = (),
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
    `corrector`). hold_out: designs whose trials are not learned from. model: whose parameters the motions have. free:
    effects, as `calibrate` takes them, that are fitted with the declared parameters to the trials learned from, first.
    After Ctrl-C the same call goes on.
    """
    if network == "paper":
        import corrector.paper_training  # noqa: F401 loads PyTorch: without it nothing is begun
    from studies.bad_data import sound_trials
    from studies.sensitive_stretches import GRID as COARSE
    from studies.training.train import train as train_on

    base, out = one_model(model, say=say) or Model(), Path(out)
    checked = [sound_trials(read, skip_bad=skip_bad) for read in all_sets(measured)]
    base = replace(base, points_per_side=grid or base.points_per_side)
    vector = _unknowns(free, (), base, [sound for sound, _ in checked]) if free else None
    beside = out.with_suffix(".safetensors").name
    places = new_files(out, companions=[beside], force=force, inputs=paths_of(measured, model))
    motion = [float(t.times[-1]) for sound, _ in checked for t in sound.trials if t.role == "fit"]
    seconds = training_seconds(motion)
    if vector is not None:
        seconds += fit_seconds(CALIBRATION, motion, len(vector.parameters), base.points_per_side)
    # how long the paper's takes is its plan's
    opening = [in_words(seconds, f"{len(motion)} trials", on_cores())] if motion and network == "field" else []

    def announce(what: str, done: int, of: int) -> None:
        while opening:  # once it is known that there is something to learn from
            progress(opening.pop(), None)
        progress(f"{what} {done} of {of}", done / of)

    with places as unfinished, computing(cluster):
        result = train_on(
            [sound for sound, _ in checked],
            simulator(base.points_per_side),
            unfinished,
            goes_to=out,
            base=base,
            vector=vector,
            slopes=simulator(min(base.points_per_side, COARSE)),
            network=network,
            hold_out=hold_out,
            seed=seed,
            force=force,
            coarse=simulator(COARSE),
            progress=announce,
        )
    return Trained(out, result, tuple(line for _, lines in checked for line in lines))


def _unknowns(free: Sequence[str], fix: Sequence[str], base: Model, sets: Sequence[MeasurementSet]) -> FitVector:
    """What a fit of these sets moves. Raises InputError."""
    from optimize.fit.free import fit_vector

    designs = [design for one in sets for design in one.designs.values()]
    return fit_vector(free, fix, factors=base.factors, terms=base.terms, designs=designs)


@contextmanager
def _file(out: Path | str | None, force: bool, inputs: Sequence[Path]) -> Iterator[Path | None]:
    if out is None:
        yield None
        return
    with new_file(Path(out), force=force, inputs=inputs) as unfinished:
        yield unfinished
