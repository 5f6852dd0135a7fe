"""Studies of other kinds than searches: what a shape depends on, what is not measured yet, the closed loop, and any."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from fabdesign.errors import InputError
from fabdesign.interface.run import Run, all_sets
from fabdesign.interface.searches import study_verb
from fabdesign.interface.verb import VERBS, Computing, DesignLike, File, Folder, ModelLike, SetLike, Verb, verb

if TYPE_CHECKING:
    from fabdesign.files.motion_file import Motion
    from studies.loop.record import LoopOutcome
    from studies.sensitivity.result import SensitivityResult
    from studies.unseen.result import UnseenResult


@study_verb("studies.sensitivity.report")
def sensitivity(
    design: DesignLike,
    parameters: Mapping[str, tuple[float, float] | None] | None = None,
    out: Folder | None = None,
    *,
    outputs: Mapping[str, Callable[[Motion], float]] | Sequence[str] | None = None,
    covariance: bool = False,
    pressures: Sequence[float] | None = None,
    method: str | Sequence[str] = ("morris", "sobol"),
    samples: int | None = None,
    trajectories: int | None = None,
    at: Sequence[float] = (),
    model: ModelLike | None = None,
    seconds: float | None = None,
    seed: int = 1,
    grid: int | None = None,
    **keys: Any,
) -> SensitivityResult:
    """Say what a shape depends on (Morris, Sobol).

    A STUDY is a TOML file. The same command continues after a stop.

    out: Folder to write to, or to continue in.
    seconds: Time limit, s; by default the study's, or none.

    In Python `design` is the design; without parameters it is the study. parameters: the lowest and highest value of
    each, by names as `[parameters]` of a study has them (docs/sensitivity.md): "pressure.0" in kPa, "position.1.u" in
    m, "membrane" as a factor, "effects.NAME.PARAMETER"; None: the model's 90 % interval. outputs: functions of a motion
    by name, or names of the command's. at: instants of motions, s; none: shapes at rest. covariance: the model's
    parameters vary together besides. pressures: kPa of channels that do not vary. samples: a power of two. grid: points
    a side, by default 21. keys: as of `optimize`. Ctrl-C ends with what is done.
    """
    from fabdesign.interface.arguments import asked_study, ends_of, functions_of
    from fabdesign.study_files.sensitivity_file import SensitivityStudy
    from studies.sensitivity.run import run_sensitivity

    run = Run.of(keys)
    functions = functions_of(outputs) if isinstance(outputs, Mapping) else {}
    ends = {
        name: {} if pair is None else dict(zip(("low", "high"), ends_of(f"parameters: {name}", pair), strict=True))
        for name, pair in (parameters or {}).items()
    }
    asked = {
        "parameters": {**ends, "covariance": covariance},
        "method": _texts(method),
        "seed": seed,
        "outputs": None if outputs is None or functions else _texts(outputs),
        "start_pressures": None if pressures is None else [*pressures],
        "samples": samples,
        "trajectories": trajectories,
        "points_per_side": grid,
        "at": [*at] or None,
        "functions": {name: _of_motion(function) for name, function in functions.items()} or None,
    }
    is_study = parameters is None and not covariance
    study = asked_study(SensitivityStudy.read, design, keys, None if is_study else asked, run.model(model))

    def show(now: Any) -> None:
        run.progress(str(now), now.done / now.total)

    return run.study(run_sensitivity, study, out, seconds, progress=show, on_interrupt="end")


def _texts(names: str | Sequence[str] | Mapping[str, Any]) -> list[str]:
    return [names] if isinstance(names, str) else [*names]


def _of_motion(function: Callable[[Motion], float]) -> Callable[[Any, Any], float]:
    from fabdesign.files.motion_file import Motion

    @wraps(function)
    def output(time: Any, points: Any) -> float:
        return function(Motion(time, points))

    return output


@study_verb("studies.unseen.report")
def unseen(
    design: DesignLike | None = None,
    model: ModelLike | None = None,
    out: Folder | None = None,
    *,
    pressures: Sequence[Sequence[float]] | None = None,
    outputs: Sequence[str] = (),
    measured: SetLike | None = None,
    trials: int = 12,
    free: Sequence[str] = (),
    samples: int = 32,
    seconds: float | None = None,
    seed: int = 1,
    grid: int | None = None,
    **keys: Any,
) -> UnseenResult:
    """Predict a layout before it is sewn, with intervals.

    A STUDY is a TOML file. The command says which measurement would narrow the intervals; designs of a measured set are
    left out in turn. The same command continues after a stop.

    out: Folder to write to, or to continue in.
    seconds: Time limit, s; by default the study's.

    In Python `design` goes with a `model` that has a covariance; with neither model nor set it is the study. pressures:
    kPa, a row a pose. outputs: of each shape, in words (docs/sensitivity.md). measured: a set of two designs or more,
    of which at most so many `trials` of each are evaluated; free: effects fitted to the others, as `calibrate --free`
    takes them. samples: models drawn. grid: points a side, by default the model's. keys: as of `optimize`, such as
    `candidates`, `rig_limits`, `rise`, `hold`.
    """
    from fabdesign.interface.arguments import asked_study
    from fabdesign.study_files.unseen_file import UnseenStudy
    from studies.unseen.run import run_unseen

    run = Run.of(keys)
    is_study = model is None and measured is None
    if not is_study and (design is None) != (model is None):
        raise InputError("unseen: a design or a model alone; expected both, or neither beside measured")
    one_set = None if measured is None else all_sets(measured)[0]
    asked = {
        "samples": samples,
        "seed": seed,
        "outputs": [*outputs],
        "pressures": pressures,
        "points_per_side": grid,
        "measured": one_set and {"set": one_set, "trials": trials, "free": [*free]},
    }
    study = asked_study(UnseenStudy.read, design, keys, None if is_study else asked, run.model(model))
    return run.study(run_unseen, study, out, seconds, progress=run.progress)


@study_verb("studies.loop.record", 0.0)
def loop(study: File, out: Folder, *, seconds: float | None = None, **given: Unpack[Computing]) -> LoopOutcome:
    """Choose a design, measure it, improve the model, repeat.

    A STUDY is a TOML file with a target. Measurements come from a virtual rig or from a laboratory. With a laboratory
    the command ends where it needs a measurement set. Run it again when the set is there.

    out: Folder to write to, or to continue in.
    seconds: Time limit of each search, s; by default the study's.
    """
    from studies.loop.run import run_loop

    run = Run(**given)
    return run.study(run_loop, Path(study), out, seconds, progress=run.progress)


def _kind(study: File) -> Verb:
    from fabdesign.study_files.study_file import read_head

    return VERBS[read_head(study).kind]


def _of_its_kind(given: dict[str, Any]) -> Verb:
    """Return the verb of a study's kind, with the study as its argument."""
    verb = _kind(given["study"])
    given[next(iter(verb.arguments))] = given.pop("study")
    return verb


@verb(None, from_shell=_of_its_kind)
def study(study: File, out: Folder, *, seconds: float | None = None, **given: Unpack[Computing]) -> Any:
    """Run a STUDY of any kind.

    A STUDY is a TOML file; its kind is optimize, sensitivity, layouts, unseen, loop or follow.

    out: Folder to write to, or to continue in.

    Returns what the function of that kind does.
    """
    return _kind(study).function(study, out=out, seconds=seconds, **given)
