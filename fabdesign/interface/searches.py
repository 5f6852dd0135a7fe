"""Searches and sweeps: a layout with pressures for a target, layouts side by side, and what a shape depends on."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fabdesign.errors import InputError
from fabdesign.interface.arguments import (
    DesignLike,
    ModelLike,
    Progress,
    Say,
    computing,
    ends_of,
    functions_of,
    one_design,
    one_model,
    study_file,
    unheard,
    warn,
    work_folder,
)
from fabdesign.interface.results import Motion
from fabdesign.interface.study_results import Layouts, Optimized, Sensitivity
from fabdesign.units import in_mm

Target = ArrayLike | Path | str  # (n, 3) m, or a cloud, mesh or trial


def optimize(
    design: DesignLike,
    target: Target | Sequence[Path | str] | None = None,
    out: Path | str | None = None,
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
    force: bool = False,
    progress: Progress = unheard,
    say: Say = warn,
    cluster: str | None = None,
    **keys: Any,
) -> Optimized:
    """The layout and pressures of a design that come closest to a target; Ctrl-C ends with the best so far.

    design: what the search begins with, and whatever is not varied; or, without a target, the file of a study, as the
    command takes it. target: points (n, 3) m, or the file of a cloud, a mesh or a trial; a list of files are poses that
    share one layout. out: the folder for what the command writes, and to go on in; without it nothing is kept. muscles:
    the fewest and the most; None: those of the design stay. pressures, positions: whether they vary; positions do by
    default where `muscles` is given. limits: as `[limits]` of a study has them, pressures in kPa. keys: further ones
    of a study (docs/files.md), such as `objective`, `start_pressures`, `order`, `rise`; of a target `place`, `frame`.
    Raises InputError for what a study may not be, or where `out` holds other files.
    """
    from studies.layouts.run import run_study

    with _scratch() as folder:
        if target is None:
            study = study_file(design)
            where = study
        else:
            given = {**(limits or {})}
            given |= {} if evaluations is None else {"evaluations": evaluations}
            least, most = (None, None) if muscles is None else ends_of("muscles", muscles)
            choice = {} if muscles is None else {"muscles": {"min": least, "max": most, "sides": [*sides]}}
            varied = {"pressures": pressures, **({} if positions is None else {"positions": positions}), **choice}
            root = {"seed": seed, "variables": varied, "limits": given, **_targets(target, folder, keys), **keys}
            study, where = _search(root, design, one_model(model, say=say)), None
        with work_folder(out) as work, computing(cluster, where, say=say):
            result = run_study(
                study,
                work,
                seconds=seconds,
                force=force,
                progress=lambda at: progress(_best(at), at.share),
            )
    return Optimized(result)


def layouts(
    design: DesignLike,
    target: Target | Sequence[Path | str] | None = None,
    out: Path | str | None = None,
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
    force: bool = False,
    progress: Progress = unheard,
    say: Say = warn,
    cluster: str | None = None,
    **keys: Any,
) -> Layouts:
    """How near a target each number of muscles comes: a search for every one of `muscles`, `types` and `sides`.

    design: its cloth and muscle types; or, without a target, the file of a study of kind `layouts`. types: of the
    design's muscle types, by default all. outputs: of each layout's shapes, in words (docs/sensitivity.md), such as
    "height of corner (0.2, 0.2)". seconds, evaluations: of all searches together. Other arguments, Ctrl-C and errors
    are those of `optimize`.
    """
    from fabdesign.layouts_file import read_layouts
    from studies.layout_grid.run import run_layouts

    with _scratch() as folder:
        if target is None:
            study: Any = study_file(design)
            where = study
        else:
            given = {**(limits or {}), **({} if evaluations is None else {"evaluations": evaluations})}
            grid = {"muscles": [*muscles], "sides": [*sides], **({} if types is None else {"types": [*types]})}
            own = one_design(design)
            root = {"name": own.name, "seed": seed, "grid": grid, "limits": given, "outputs": [*outputs]}
            root |= {**_targets(target, folder, keys), **keys}
            study, where = read_layouts({**root, "design": own, "model": one_model(model, say=say)}), None
        with work_folder(out) as work, computing(cluster, where, say=say):
            result = run_layouts(
                study,
                work,
                seconds=seconds,
                force=force,
                progress=lambda cell, number, of, at: progress(f"{cell.name} ({number} of {of}): {_best(at)}", None),
            )
    return Layouts(result)


def sensitivity(
    design: DesignLike,
    parameters: Mapping[str, tuple[float, float] | None] | None = None,
    out: Path | str | None = None,
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
    force: bool = False,
    progress: Progress = unheard,
    say: Say = warn,
    cluster: str | None = None,
    **keys: Any,
) -> Sensitivity:
    """What a shape depends on: Morris screening and Sobol indices, with intervals. Ctrl-C ends with what is done.

    design: the design; or, without parameters, the file of a study, as the command takes it. parameters: the lowest and
    highest value of each, by names as `[parameters]` of a study has them (docs/sensitivity.md): "pressure.0" in kPa,
    "position.1.u" in m, "membrane" as a factor, "effects.NAME.PARAMETER"; None: the model's 90 % interval. outputs:
    functions of a motion by name, or names of the command's. at: instants of motions, s; none: shapes at rest.
    covariance: the model's parameters vary together besides. pressures: kPa of channels that do not vary. samples: a
    power of two. grid: points a side, by default 21. out: as in `optimize`. keys: further ones of a study, such as
    `order`, `rise`, `hold`.

    """
    from fabdesign.sensitivity_file import read_sensitivity
    from studies.sensitivity.run import run_sensitivity

    if parameters is None and not covariance:
        study: Any = study_file(design)
        where = study
    else:
        functions = functions_of(outputs) if isinstance(outputs, Mapping) else {}
        tables = {
            name: {} if ends is None else dict(zip(("low", "high"), ends_of(f"parameters: {name}", ends), strict=True))
            for name, ends in (parameters or {}).items()
        }
        root = {"parameters": {**tables, "covariance": covariance}, "method": _texts(method), "seed": seed, **keys}
        optional = {
            "outputs": None if outputs is None or functions else _texts(outputs),
            "start_pressures": None if pressures is None else [*pressures],
            "samples": samples,
            "trajectories": trajectories,
            "points_per_side": grid,
            "at": [*at] or None,
        }
        root |= {name: value for name, value in optional.items() if value is not None}
        root |= {"functions": {name: _of_motion(function) for name, function in functions.items()} or None}
        root |= {"design": one_design(design), "model": one_model(model, say=say)}
        study, where = read_sensitivity(root), None
    with work_folder(out) as folder, computing(cluster, where, say=say):
        result = run_sensitivity(
            study,
            folder,
            seconds=seconds,
            force=force,
            progress=lambda now: progress(str(now), now.done / now.total),
            interruptible=True,
        )
    return Sensitivity(result)


@contextmanager
def _scratch() -> Iterator[Path]:
    """A folder for an array of points; what is wrong with them is said of the target."""
    with tempfile.TemporaryDirectory(prefix="fabdesign_") as folder:
        try:
            yield Path(folder)
        except InputError as error:
            raise InputError(str(error).replace(str(Path(folder) / "target.npz"), "target")) from error


def _search(root: dict[str, Any], design: DesignLike, model: Any) -> Any:
    from fabdesign.study_file import read_study

    own = one_design(design)
    return replace(read_study({**root, "design": own, "model": model}), name=own.name)


_OF_TARGET = ("frame", "unit", "scale", "rotation", "translation", "place", "description")


def _targets(target: Any, folder: Path, keys: dict[str, Any]) -> dict[str, Any]:
    """`[target]` or `[[targets]]`, with the keys that are theirs; points become a file in `folder`."""
    own = {name: keys.pop(name) for name in _OF_TARGET if name in keys}
    if isinstance(target, Path | str):
        return {"target": {"file": _absolute(target), **own}}
    if isinstance(target, list | tuple) and all(isinstance(one, Path | str) for one in target):
        return {"targets": [{"file": _absolute(one), **own} for one in target]}
    try:
        points = np.asarray(target, dtype=float)
    except (TypeError, ValueError):
        raise InputError("target: no array of numbers; expected points (n, 3) in m, or a file") from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"target: an array of shape {points.shape}; expected points (n, 3) in m")
    np.savez(folder / "target.npz", points=points)
    return {"target": {"file": str(folder / "target.npz"), "description": f"{len(points)} points", **own}}


def _absolute(file: Path | str) -> str:
    return str(Path(file).absolute())


def _texts(names: str | Sequence[str] | Mapping[str, Any]) -> list[str]:
    return [names] if isinstance(names, str) else [*names]


def _of_motion(function: Callable[[Motion], float]) -> Callable[[NDArray[np.float64], NDArray[np.float32]], float]:
    @wraps(function)
    def output(time: NDArray[np.float64], points: NDArray[np.float32]) -> float:
        return function(Motion(time, points))

    return output


def _best(evaluations: Any) -> str:
    best = "none yet" if evaluations.best is None else f"{in_mm(evaluations.best.value):.3f} mm"
    return f"best {best} after {evaluations.history.evaluations} evaluations"
