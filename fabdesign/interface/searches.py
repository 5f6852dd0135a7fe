"""Searches: a layout with pressures for a target, layouts side by side, the demo."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from fabdesign.errors import InputError
from fabdesign.interface.run import Run
from fabdesign.interface.verb import Shown, Working, verb

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from fabdesign.interface.results import Layouts, Optimized
    from fabdesign.interface.verb import DesignLike, File, Folder, ModelLike, Pressures
    from optimize.search.evaluations import Evaluations
    from studies.demo.run import Demo
    from studies.follow.result import FollowResult

    Target = ArrayLike | File  # (n, 3) m, or a cloud, mesh or trial

OF_STUDY = ("seconds", "effects", "cluster", "out", "force")  # options of a command that takes a study
INTERVAL = 10.0  # s between the lines of a search, which has a step a second


def reported(text: str, given: Mapping[str, Any]) -> str:
    """Return what is printed of a study, with the place of its page."""
    return f"{text}\nreport: {Path(given['out']) / 'report.html'}"


def _optimized(result: Optimized, given: Mapping[str, Any]) -> Shown:
    from fabdesign.geometry.metrics import MANY_BEYOND, told_beyond
    from fabdesign.nouns.pressure import poses_in_words
    from studies.layout_search.target import errors_in_words

    content = result.to_json()
    text = (
        f"{given['out']}: {content['objective_mm']:.3f} mm ({errors_in_words(result.study, result.errors)}) after "
        f"{content['evaluations']} evaluations, {result.search_time}; {content['stop_reason']}"
    )
    outputs = [f"{name}: {', '.join(values)}" for name, values in result.outputs.items()]
    after = [content["fewer"]["said"]] if content["fewer"] else []
    after += [result.within_said] if result.within_said else []
    after += content["robust"]["said"] if content["robust"] else []
    after += [*content["reach"]["said"], *content["way"]["said"]]
    if content["surface_beyond"] >= MANY_BEYOND:
        after.append(told_beyond(content["surface_beyond"]))
    targets = [f"target: {target}" for target in content["targets"]]
    poses = poses_in_words([*result.result.pressures])
    return Shown(content, "\n".join([*targets, text, *poses, *outputs, *after]))


@verb(_optimized, "STUDY", options=OF_STUDY, search=True)
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
) -> Optimized:
    """Find layout and pressures for the target of a STUDY.

    A STUDY is a TOML file. Ctrl-C keeps the best so far; the same command goes on from there.

    out: Folder to write to, or to continue in.
    seconds: Time limit of the search, s; by default the study's.

    In Python `design` is what the search begins with, and whatever is not varied; without a target it is the study.
    target: points (n, 3) m, or the file of a cloud, a mesh or a trial; several files are poses that share one layout.
    muscles: the fewest and the most; None: those of the design stay. positions vary by default where `muscles` is
    given. limits: as `[limits]` of a study has them, pressures in kPa. keys: `force`, `progress`, `say`, `cluster` and
    further keys of a study (docs/studies.md), such as `objective`, `start_pressures`, `order`; of a target `place`,
    `frame`. Without `out` nothing is kept. Raises InputError for what a study may not be.
    """
    from fabdesign.interface.arguments import ends_of, one_design, study_file
    from fabdesign.interface.results import Optimized
    from fabdesign.study_files.study_file import read_study
    from studies.layouts.run import run_study

    run = Run.of(keys)
    with _scratch() as folder:
        if target is None:
            study: Any = study_file(design)
        else:
            choice = {}
            if muscles is not None:
                least, most = ends_of("muscles", muscles)
                choice = {"muscles": {"min": least, "max": most, "sides": [*sides]}}
            keys |= dict(
                seed=seed,
                variables={"pressures": pressures, "positions": positions, **choice},
                limits={**(limits or {}), "evaluations": evaluations},
                **_targets(target, folder, keys),
                design=(read := one_design(design)),
                model=run.model(model),
            )
            study = replace(read_study(keys), name=read.name)
        # a live line shows all of a search
        show = getattr(run.progress, "show", lambda at: run.progress(_best(at), at.share))
        return Optimized(run.study(run_study, study, out, seconds, progress=show))


def _side_by_side(result: Layouts, given: Mapping[str, Any]) -> Shown:
    from studies.layout_grid.report import as_text

    return Shown(result.to_json(), reported(as_text(result.result), given))


@verb(_side_by_side, "STUDY", options=OF_STUDY, interval=INTERVAL)
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
) -> Layouts:
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
    from fabdesign.interface.arguments import one_design, study_file
    from fabdesign.interface.results import Layouts
    from fabdesign.runtime.effort import in_words
    from fabdesign.study_files.layouts_file import read_layouts
    from studies.layout_grid.run import run_layouts

    run = Run.of(keys)
    with _scratch() as folder:
        if target is None:
            study: Any = study_file(design)
        else:
            read = one_design(design)
            keys |= dict(
                name=read.name,
                seed=seed,
                grid={"muscles": [*muscles], "sides": [*sides], "types": None if types is None else [*types]},
                limits={**(limits or {}), "evaluations": evaluations},
                outputs=[*outputs],
                **_targets(target, folder, keys),
                design=read,
                model=run.model(model),
            )
            study = read_layouts(keys)
        total = 0

        def opening() -> str:
            search = (read_layouts(study) if isinstance(study, Path) else study).search
            limit = seconds or search.limits.seconds
            return in_words(limit, f"{total} searches, all within {limit:g} s of search time")

        show = run.opened(opening)

        def cell(cell: Any, number: int, of: int, at: Evaluations) -> None:
            nonlocal total
            total = of
            line = f"{cell.name}, {number} of {of}: {_best(at)}, {at.elapsed:.0f} s in this search"
            show(line, min(1.0, (number - 1 + at.share) / of))

        return Layouts(run.study(run_layouts, study, out, seconds, progress=cell))


def _followed(result: FollowResult, given: Mapping[str, Any]) -> Shown:
    from studies.follow.result import as_text

    return Shown(result.as_json(), reported(as_text(result), given))


@verb(_followed, "STUDY", options=("measured", *OF_STUDY), interval=INTERVAL)
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
    from fabdesign.interface.arguments import one_design, study_file
    from fabdesign.study_files.follow_file import read_follow
    from studies.follow.run import follow_in_words, run_follow

    run = Run.of(keys)
    if target is None:
        study: Any = study_file(design)
    else:
        if isinstance(target, Path | str):
            keys["motion"] = {"file": str(Path(target).absolute())}
        else:
            keys["moments"] = [*target]
        keys |= {
            "name": (read := one_design(design)).name,
            "seed": seed,
            "start": None if start is None else str(start),
            "rig_limits": {**(rig_limits or {})},
            "points_per_side": grid,
            "design": read,
            "model": run.model(model),
        }
        study = read_follow(keys)
    show = run.opened(lambda: follow_in_words(read_follow(study) if isinstance(study, Path) else study))
    result: FollowResult = run.study(run_follow, study, out, seconds, measured=measured, progress=show)
    return result


def _shown(outcome: Demo, given: Mapping[str, Any]) -> Shown:
    from studies.demo.run import as_json, as_text

    return Shown(as_json(outcome), reported(as_text(outcome), given))


@verb(_shown, search=True, title="demo")
def demo(out: Folder = "demo", **given: Unpack[Working]) -> Demo:
    """Find a layout for an embedded measured cloud.

    The demo writes the layout, its pressures and a report.
    """
    from studies.demo.run import run_demo

    run = Run(**given)
    show = getattr(run.progress, "show", lambda at: run.progress(_best(at), at.share))
    say = getattr(run.progress, "say", run.say)
    return run_demo(Path(out), force=run.force, progress=lambda name, evaluations: show(evaluations), say=say)


@contextmanager
def _scratch() -> Iterator[Path]:
    """Yield a folder for an array of points; errors in them are reported as the target's."""
    with tempfile.TemporaryDirectory(prefix="fabdesign_") as folder:
        try:
            yield Path(folder)
        except InputError as error:
            raise InputError(str(error).replace(str(Path(folder) / "target.npz"), "target")) from error


_OF_TARGET = ("frame", "unit", "scale", "rotation", "translation", "place", "description")


def _targets(target: Any, folder: Path, keys: dict[str, Any]) -> dict[str, Any]:
    """Return `[target]` or `[[targets]]`, with the keys that are theirs; points become a file in `folder`."""
    import numpy as np

    shared = {name: keys.pop(name) for name in _OF_TARGET if name in keys}
    if isinstance(target, Path | str):
        return {"target": {"file": str(Path(target).absolute()), **shared}}
    if isinstance(target, list | tuple) and all(isinstance(one, Path | str) for one in target):
        return {"targets": [{"file": str(Path(one).absolute()), **shared} for one in target]}
    try:
        points = np.asarray(target, dtype=float)
    except (TypeError, ValueError):
        raise InputError("target: no array of numbers; expected points (n, 3) in m, or a file") from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"target: an array of shape {points.shape}; expected points (n, 3) in m")
    np.savez(folder / "target.npz", points=points)
    return {"target": {"file": str(folder / "target.npz"), "description": f"{len(points)} points", **shared}}


def _best(at: Evaluations) -> str:
    from fabdesign.units import in_mm

    return "best none yet" if at.best is None else f"best {in_mm(at.best.value):.3f} mm"
