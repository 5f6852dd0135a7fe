"""Searches: a layout with pressures for a target, layouts side by side, pressures that follow a motion, the demo."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from fabdesign.errors import InputError
from fabdesign.interface.run import Run
from fabdesign.interface.verb import DesignLike, File, Folder, Function, ModelLike, Pressures, Shown, Working, verb

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optimize.search.evaluations import Evaluations
    from studies.demo.run import Demo
    from studies.follow.result import FollowResult
    from studies.layout_grid.turns import GridResult
    from studies.layouts.result import StudyResult

    Target = ArrayLike | File  # (n, 3) m, or a cloud, mesh or trial

_INTERVAL = 10.0  # s between the lines of a search, which has a step a second
_OF_TARGET = ("frame", "unit", "scale", "rotation", "translation", "place", "description")


def study_verb(module: str, interval: float = _INTERVAL, **how: Any) -> Callable[[Function], Function]:
    """Declare a verb that takes a study and writes a page. module: whose `as_text` says in words what the study came
    to. interval: s between the lines of progress. how: as `verb` takes it."""

    def shown(result: Any, given: Mapping[str, Any]) -> Shown:
        text = import_module(module).as_text(result)
        return Shown(result, f"{text}\nreport: {Path(given['out']) / 'report.html'}")

    return verb(shown, "STUDY", interval=interval, **how)


def followed(run: Run) -> Callable[..., None]:
    """Return what says how a search stands, by its name where there are several, and once what it came to."""
    message = ""

    def show(at: Evaluations, search: str = "") -> None:
        nonlocal message
        name = f"{search}: " if search else ""
        if at.message and at.message != message:
            run.progress(name + at.message, None)
        message = at.message
        done = f"{at.history.evaluations} evaluations, {at.elapsed:.0f} s"
        rest = f"{max(0.0, at.seconds - at.elapsed):.0f} s left at most"
        run.progress(f"{name}{at.stage}: {at.best_in_words}, {done}, {rest}", at.share)

    return show


def _optimized(result: StudyResult, given: Mapping[str, Any]) -> Shown:
    from fabdesign.geometry.metrics import MANY_BEYOND, beyond_in_words
    from fabdesign.nouns.pressure import poses_in_words
    from fabdesign.units import in_mm
    from studies.layout_search.target import errors_in_words

    text = (
        f"{given['out']}: {in_mm(result.objective):.3f} mm ({errors_in_words(result.study, result.errors)}) after "
        f"{len(result.history)} evaluations, {result.search_time}; {result.stop_reason}"
    )
    outputs = [f"{name}: {', '.join(values)}" for name, values in result.outputs.items()]
    after = [line for line in (result.fewer_in_words, result.within_in_words) if line]
    after += result.robust.sentences if result.robust else []
    after += result.reach.sentences + (result.loading_path.sentences if result.loading_path else [])
    if result.errors.beyond >= MANY_BEYOND:
        after.append(beyond_in_words(result.errors.beyond))
    targets = [f"target: {target.description}" for target in result.targets]
    return Shown(result, "\n".join([*targets, text, *poses_in_words([*result.pressure]), *outputs, *after]))


@verb(_optimized, "STUDY", interval=_INTERVAL, search=True)
def optimize(
    design: DesignLike,
    target: Target | Sequence[File] | None = None,
    out: Folder | None = None,
    *,
    muscles: tuple[int, int] | None = None,
    sides: Sequence[str] = ("front", "back"),
    pressures: bool = True,
    positions: bool | None = None,
    limits: Mapping[str, Any] | None = None,
    model: ModelLike | None = None,
    seconds: float | None = None,
    evaluations: int | None = None,
    seed: int = 1,
    **keys: Any,
) -> StudyResult:
    """Find layout and pressures for the target of a STUDY.

    A STUDY is a TOML file. Ctrl-C keeps the best so far; the same command goes on from there.

    out: Folder to write to, or to continue in.
    seconds: Time limit of the search in all calls on a folder together, s; by default the study's.

    In Python `design` is what the search begins with, and whatever is not varied; without a target it is the study.
    target: points (n, 3) m, or the file of a cloud, a mesh or a trial; several files are poses that share one layout.
    muscles: the fewest and the most; None: those of the design stay. positions vary by default where `muscles` is
    given. limits: as `[limits]` of a study has them, pressures in kPa. keys: `force`, `progress`, `say`, `cluster` and
    further keys of a study (docs/studies.md), such as `objective`, `start_pressures`, `order`; of a target `place`,
    `frame`. Without `out` nothing is kept. Raises InputError for what a study may not be.
    """
    from fabdesign.interface.arguments import asked_study, ends_of
    from fabdesign.study_files.study_file import read_study
    from studies.layouts.run import run_study

    run = Run.of(keys)
    count = None if muscles is None else dict(zip(("min", "max"), ends_of("muscles", muscles), strict=True))
    asked = {
        "seed": seed,
        "variables": {
            "pressures": pressures,
            "positions": positions,
            "muscles": count and {**count, "sides": [*sides]},
        },
        "limits": {**(limits or {}), "evaluations": evaluations},
        **_targets(target, keys),
    }
    study = asked_study(read_study, design, keys, None if target is None else asked, run.model(model))
    return run.study(run_study, study, out, seconds, progress=followed(run))


@study_verb("studies.layout_grid.report")
def layouts(
    design: DesignLike,
    target: Target | Sequence[File] | None = None,
    out: Folder | None = None,
    *,
    muscles: Sequence[int] = (1, 2, 4),
    types: Sequence[str] | None = None,
    sides: Sequence[str] = ("front", "back", "both"),
    limits: Mapping[str, Any] | None = None,
    outputs: Sequence[str] = (),
    model: ModelLike | None = None,
    seconds: float | None = None,
    evaluations: int | None = None,
    seed: int = 1,
    **keys: Any,
) -> GridResult:
    """Find out how many muscles a target needs, of which type, on which side.

    A STUDY is a TOML file: a search for each number, type and choice of sides. Ctrl-C keeps what is there; the same
    command goes on from there.

    out: Folder to write to, or to continue in.
    seconds: Time limit of all searches together, s; by default the study's.

    In Python `design` has the cloth and the muscle types; without a target it is the study. types: of the design's
    muscle types, by default all. outputs: of each layout's shapes, in words (docs/sensitivity.md), such as "height of
    corner (0.2, 0.2)". seconds, evaluations: of all searches together. Other arguments and errors are those of
    `optimize`.
    """
    from fabdesign.interface.arguments import asked_study
    from fabdesign.runtime.effort import in_words
    from fabdesign.study_files.layouts_file import LayoutsStudy
    from studies.layout_grid.run import run_layouts

    run = Run.of(keys)
    asked = {
        "seed": seed,
        "grid": {"muscles": [*muscles], "sides": [*sides], "types": None if types is None else [*types]},
        "limits": {**(limits or {}), "evaluations": evaluations},
        "outputs": [*outputs],
        **_targets(target, keys),
    }
    study = asked_study(LayoutsStudy.read, design, keys, None if target is None else asked, run.model(model))
    total = 0

    def opening() -> str:
        limit = seconds or (LayoutsStudy.read(study) if isinstance(study, Path) else study).search.limits.seconds
        return in_words(limit, f"{total} searches, all within {limit:g} s of search time")

    show = run.opened(opening)

    def cell(cell: Any, number: int, of: int, at: Evaluations) -> None:
        nonlocal total
        total = of
        line = f"{cell.name}, {number} of {of}: {at.best_in_words}, {at.elapsed:.0f} s in this search"
        show(line, min(1.0, (number - 1 + at.share) / of))

    return run.study(run_layouts, study, out, seconds, progress=cell)


@study_verb("studies.follow.result")
def follow(
    design: DesignLike,
    target: File | Sequence[Mapping[str, Any]] | None = None,
    out: Folder | None = None,
    *,
    measured: File | None = None,
    start: Pressures | None = None,
    rig_limits: Mapping[str, Any] | None = None,
    model: ModelLike | None = None,
    seconds: float | None = None,
    seed: int = 1,
    grid: int | None = None,
    **keys: Any,
) -> FollowResult:
    """Find pressures over time for the moving target of a STUDY.

    A STUDY is a TOML file. The same command continues after a stop. Run the pressures on the device, and give what was
    measured to correct them.

    out: Folder to write to, or to continue in.
    measured: What was measured of the folder's last pressures: a set or a trial; they are corrected by it.
    seconds: Time limit, s; by default the study's, or none.

    In Python `design` is what is driven; without a target it is the study. target: the file of a trial or a motion, or
    a folder of clouds or meshes; or moments, each with a `time` [s] and the keys of a target or `wishes`. start: a file
    of pressures to begin with. rig_limits: as `[rig_limits]` of a study has them. grid: points a side, by default the
    model's. keys: as of `optimize`, and further keys of a study.
    """
    from fabdesign.interface.arguments import asked_study
    from fabdesign.study_files.follow_file import FollowStudy
    from studies.follow.run import run_follow

    run = Run.of(keys)
    asked = {
        "seed": seed,
        "start": None if start is None else str(start),
        "rig_limits": {**(rig_limits or {})},
        "points_per_side": grid,
        "motion": {"file": _absolute(target)} if isinstance(target, Path | str) else None,
        "moments": None if target is None or isinstance(target, Path | str) else [*target],
    }
    study = asked_study(FollowStudy.read, design, keys, None if target is None else asked, run.model(model))
    return run.study(run_follow, study, out, seconds, measured=measured, progress=run.progress)


@study_verb("studies.demo.run", search=True, title="demo")
def demo(out: Folder = "demo", **given: Unpack[Working]) -> Demo:
    """Find a layout for an embedded measured cloud.

    The demo writes the layout, its pressures and a report.
    """
    from studies.demo.run import run_demo

    run = Run(**given)
    show = followed(run)
    return run_demo(
        Path(out), force=run.force, progress=lambda name, at: show(at, name), say=lambda line: run.progress(line, None)
    )


def _targets(target: Any, keys: dict[str, Any]) -> dict[str, Any]:
    """Return `[target]` or `[[targets]]`, with the keys that are theirs."""
    import numpy as np

    if target is None:
        return {}
    shared = {name: keys.pop(name) for name in _OF_TARGET if name in keys}
    if isinstance(target, Path | str):
        return {"target": {"file": _absolute(target), **shared}}
    if isinstance(target, list | tuple) and all(isinstance(one, Path | str) for one in target):
        return {"targets": [{"file": _absolute(one), **shared} for one in target]}
    try:
        points = np.asarray(target, dtype=float)
    except (TypeError, ValueError):
        raise InputError("target: no array of numbers; expected points (n, 3) in m, or a file") from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"target: an array of shape {points.shape}; expected points (n, 3) in m")
    return {"target": {"points": points, "description": f"{len(points)} points", **shared}}


def _absolute(file: Any) -> str:
    return str(Path(file).absolute())
