"""Motions and shapes of designs: one, a batch, or a sweep into a table."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fabdesign.cluster import at_once
from fabdesign.design import Design
from fabdesign.forward import HOLD, RISE, Case, ForwardModel
from fabdesign.interface.arguments import (
    DesignLike,
    ModelLike,
    Pressures,
    Progress,
    computing,
    functions_of,
    one_model,
    pairs,
    simulator,
    unheard,
    warn,
)
from fabdesign.interface.results import Motion, Sweep
from fabdesign.model import Model
from fabdesign.pressure import PressureProgram, rising_program
from fabdesign.units import in_kpa

FRAME_RATE = 60.0  # Hz, as `fabdesign simulate` has it
_AT_ONCE = 64  # what the simulator takes side by side


def simulate(
    design: DesignLike | Sequence[DesignLike],
    pressures: Pressures = None,
    *,
    model: ModelLike | None = None,
    without: Sequence[str] = (),
    duration: float | None = None,
    frame_rate: float = FRAME_RATE,
    order: int = 0,
    grid: int | None = None,
    self_contact: bool = False,
    progress: Progress = unheard,
    cluster: str | None = None,
) -> Any:
    """The motion of a design under pressures, from rest; of several designs or pressures a list of them, in one batch.

    pressures: kPa of every channel, held for 1.5 s; or a program, or a file of one; for several, one for each, or one
    for all. without: parts of the model that are left out. duration: s; by default the pressures'. frame_rate: Hz.
    order: the motion's place in the specimen's session. grid: points a side, by default the model's or 41. Ctrl-C ends
    a batch with the motions that are done, the first ones, and a warning; it is raised where there are none. Raises
    InputError for what does not fit together, SimulationError where a motion diverges.

    >>> import fabdesign
    >>> motion = fabdesign.simulate(fabdesign.build("cross", muscles=2), [200, 0], duration=0.1, grid=21)
    >>> motion.time.shape, motion.faces.shape
    ((7,), (7, 2, 41, 41, 3))
    """
    from studies.forward_model import extrapolated
    from studies.predict import frame_times, require_motions

    given, lone = pairs(design, pressures)
    fitted = one_model(model, without)
    side = grid or (fitted or Model()).points_per_side
    times = [frame_times(p, duration=duration, frame_rate=frame_rate, points_per_side=side) for _, p in given]
    for line in extrapolated(fitted, [program for _, program in given]):
        warn(line)
    with computing(cluster):
        forward = simulator(side, self_contact=self_contact)

        def moved(part: slice) -> list[Motion]:
            cases = [Case(*pair, order=order) for pair in given[part]]
            motions = require_motions(forward, cases, times[part], model=fitted)
            return [Motion(each.time, each.points) for each in motions]

        results = _until_stopped(given, moved, progress)
    return results[0] if lone else results


def equilibrium(
    design: DesignLike | Sequence[DesignLike],
    pressures: Pressures = None,
    *,
    model: ModelLike | None = None,
    without: Sequence[str] = (),
    order: int = 0,
    grid: int | None = None,
    self_contact: bool = False,
    rise: float = RISE,
    hold: float = HOLD,
    progress: Progress = unheard,
    cluster: str | None = None,
) -> Any:
    """The shape at rest after pressures [kPa of every channel] rose linearly: a motion of one frame; of several designs
    or pressures a list of them, in one batch.

    rise: s, in which pressures rise; hold: s, for which they then hold, where effects remember. Other arguments and
    errors are those of `simulate`.

    >>> import fabdesign
    >>> shape = fabdesign.equilibrium(fabdesign.build("vertical", muscles=2), [300, 300], grid=21)
    >>> bool(shape.faces[0, 0, -1, :, 2].mean() > 0.01)  # m: muscles in front pull the lower edge towards the viewer
    True
    """
    from studies.forward_model import extrapolated
    from studies.predict import require_shapes

    given, lone = pairs(design, pressures)
    fitted = one_model(model, without)
    for line in extrapolated(fitted, [rising_program(p.pressure[-1], rise, rise) for _, p in given]):
        warn(line)
    with computing(cluster):
        forward = simulator(
            grid or (fitted or Model()).points_per_side, self_contact=self_contact, rise=rise, hold=hold
        )

        def rested(part: slice) -> list[Motion]:
            cases = [Case(*pair, order=order) for pair in given[part]]
            return [Motion(each.time, each.points) for each in require_shapes(forward, cases, model=fitted)]

        results = _until_stopped(given, rested, progress)
    return results[0] if lone else results


def sweep(
    designs: DesignLike | Sequence[DesignLike],
    pressures: Pressures,
    outputs: Mapping[str, Callable[[Motion], float]],
    *,
    at: Sequence[float] = (),
    model: ModelLike | None = None,
    without: Sequence[str] = (),
    order: int = 0,
    grid: int | None = None,
    rise: float = RISE,
    hold: float = HOLD,
    progress: Progress = unheard,
    cluster: str | None = None,
) -> Sweep:
    """Numbers of many shapes, a row for each design with its pressures: as `equilibrium` gives them, or as `simulate`
    does at the instants `at` [s].

    outputs: functions of a motion, by name. Motions are not kept. One that cannot be computed gives NaN. Ctrl-C ends
    with the rows that are done. Other arguments and errors are those of `simulate`.

    >>> import fabdesign
    >>> cloth = fabdesign.build("vertical", muscles=2)
    >>> rows = [[100, 100], [300, 300]]  # kPa
    >>> outputs = fabdesign.sweep(cloth, rows, {"forward": lambda motion: motion.points[-1, :, 2].mean()}, grid=21)
    >>> bool(outputs["forward"][0] < outputs["forward"][1])
    True
    """
    from studies.forward_model import forward_model

    functions = functions_of(outputs)
    given, _ = pairs(designs, pressures)
    fitted = one_model(model, without)
    rows: list[list[float]] = []
    with computing(cluster):
        bare = simulator(grid or (fitted or Model()).points_per_side, rise=rise, hold=hold)
        forward = forward_model(bare, fitted)
        try:
            for part in _parts(given, progress, "swept"):
                shapes = _shapes(forward, [Case(*pair, order=order) for pair in given[part]], at)
                rows += [[_value(function, motion) for function in functions.values()] for motion in shapes]
        except KeyboardInterrupt:
            progress(f"interrupted, with {len(rows)} of {len(given)} rows", len(rows) / len(given))
    values = dict(zip(functions, np.array(rows).reshape(-1, len(functions)).T, strict=True))
    done = given[: len(rows)]
    last = [in_kpa(program.pressure[-1]) for _, program in done]
    return Sweep(tuple(design for design, _ in done), tuple(last), values, len(rows) == len(given))


def _until_stopped(
    given: Sequence[tuple[Design, PressureProgram]], compute: Callable[[slice], list[Motion]], progress: Progress
) -> list[Motion]:
    """Motions of batch after batch, up to the end or Ctrl-C; it is raised where nothing is done yet."""
    motions: list[Motion] = []
    try:
        for part in _parts(given, progress, "simulated"):
            motions += compute(part)
    except KeyboardInterrupt:
        if not motions:
            raise
        warn(f"interrupted, with the first {len(motions)} of {len(given)} motions")
    return motions


def _shapes(forward: ForwardModel, cases: Sequence[Case], at: Sequence[float]) -> list[Motion]:
    if not len(at):
        return [Motion(np.array([case.program.duration]), shape[None]) for case, shape in _at_rest(forward, cases)]
    time = np.asarray(at, dtype=float)
    return [Motion(time, points) for points in forward.motions(cases, [time] * len(cases))]


def _at_rest(forward: ForwardModel, cases: Sequence[Case]) -> Iterator[tuple[Case, np.ndarray]]:
    return zip(cases, forward.equilibria(cases), strict=True)


def _value(function: Callable[[Motion], float], motion: Motion) -> float:
    return float(function(motion)) if np.isfinite(motion.points).all() else float("nan")


def _parts(given: Sequence[tuple[Design, PressureProgram]], progress: Progress, verb: str) -> Iterator[slice]:
    """Batches of what is asked for, each told once it is done."""
    size, total = at_once(_AT_ONCE), len(given)
    for begin in range(0, total, size):
        yield slice(begin, begin + size)
        done = min(begin + size, total)
        progress(f"{verb} {done} of {total} motions", done / total)
