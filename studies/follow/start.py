"""Where the solver begins: an open layout, and shapes at rest that come near what is wanted (quasi-static)."""

from collections.abc import Sequence
from dataclasses import replace
from math import isqrt
from pathlib import Path

import numpy as np

from fabdesign.errors import InputError
from fabdesign.geometry.shape import Shape
from fabdesign.nouns.array import Array
from fabdesign.nouns.column import pressure
from fabdesign.nouns.forward import Case
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.output import WorkFolder
from fabdesign.runtime.store import write_arrays
from fabdesign.study_files.follow_file import FollowStudy
from fabdesign.study_files.study_file import Study, StudyLimits
from fabdesign.study_files.study_targets import TargetFile
from optimize.fit.descent import Progress
from optimize.search.evaluations import Evaluations
from sim import Simulator
from studies.follow.programs import UNIT, Regulator, regulator_of
from studies.follow.wanted import Wanted
from studies.follow.wanted import moved as moved_distances
from studies.layout_search.first_layouts import COARSE
from studies.layouts import run_study

APART = 0.3  # s between two instants, at least
STEPS, STEPS_OF_POSES = 3, 6  # of Gauss-Newton
BETWEEN = 0.1  # s from one shape between two poses to the next
BEGIN = 0.2  # of the highest pressures, where the first instant's search begins
FARTHEST = 0.8  # of UNIT, by which a pressure moves at once
STIFF = 1.0  # of 1 / UNIT^2: the prior's, about where a pressure is


def quasi_static(predictor: Predictor, case: Case, wanted: Wanted, regulator: Regulator, cycles: int) -> Array:
    """Return set points (cycles, channels) Pa between those whose shapes at rest are nearest to what is wanted at
    instants APART s apart. What a shape at rest cannot say keeps the pressures that it had."""
    moments = _apart(wanted.times)
    pressures = np.tile(regulator.lowest + BEGIN * (regulator.highest - regulator.lowest), (len(moments), 1))
    costs = np.full(len(moments), np.inf)
    nearest = pressures.copy()
    columns = [pressure(channel) for channel in range(regulator.channels)]
    jacobians = predictor.faces_jacobian
    assert jacobians is not None
    for _ in range(STEPS_OF_POSES if wanted.poses else STEPS):
        shapes = jacobians([_held(case, row) for row in pressures], columns)
        for k, (moment, shape) in enumerate(zip(moments, shapes, strict=True)):
            side = isqrt(len(shape.points) // 2)
            distances = wanted.distances(int(moment), shape.points, side)
            if distances is None or distances.cost >= costs[k]:
                pressures[k] = (pressures[k] + nearest[k]) / 2
                continue
            costs[k], nearest[k] = distances.cost, pressures[k]
            slopes = np.nan_to_num(UNIT * moved_distances(distances, Shape.of(shape.changes).middle))
            hessian = slopes.T @ (distances.robust[:, None] * slopes) + STIFF * np.eye(len(columns))
            change = np.linalg.solve(hessian, slopes.T @ (distances.robust * distances.off))
            moved = pressures[k] - UNIT * np.clip(change, -FARTHEST, FARTHEST)
            pressures[k] = np.clip(moved, regulator.lowest, regulator.highest)
    times = np.concatenate([[0.0], wanted.times[moments]])
    rows = np.concatenate([np.zeros((1, regulator.channels)), nearest])
    at = np.minimum(regulator.cycle * (np.arange(cycles) + 0.5), times[-1])
    if wanted.poses:  # without speed at the poses, and at rest
        after = np.searchsorted(times, at).clip(1)
        share = (at - times[after - 1]) / np.diff(times)[after - 1]
        share = share**2 * (3 - 2 * share)
        at = times[after - 1] + share * np.diff(times)[after - 1]
    return regulator.kept(np.stack([np.interp(at, times, row) for row in rows.T], axis=1))


def between_poses(predictor: Predictor, case: Case, wanted: Wanted, program: PressureProgram) -> Wanted:
    """Return what is wanted with the shapes at rest under `program` between its poses: a cloth that follows them does
    not swing. A motion stays as it is."""
    times = np.arange(BETWEEN, wanted.times[-1], BETWEEN) if wanted.poses else wanted.times[:0]
    times = times[np.abs(times[:, None] - wanted.times).min(axis=1, initial=np.inf) > BETWEEN / 2]
    rows = program.at(times)
    shapes = predictor.equilibria([_held(case, row) for row in rows]) if len(rows) else []
    sound = [k for k, shape in enumerate(shapes) if np.isfinite(shape).all()]
    return wanted.guided(times[sound], np.array([shapes[k] for k in sound])) if sound else wanted


def _held(case: Case, row: Array) -> Case:
    return replace(case, program=PressureProgram(np.zeros(1), row[None], 1.0))


def _apart(times: Array) -> Sequence[int]:
    """Return numbers of instants at least APART s apart, the last one among them."""
    chosen: list[int] = []
    for k in range(len(times) - 1, -1, -1):
        if not chosen or times[chosen[-1]] - times[k] >= APART - 1e-9:
            chosen.append(k)
    return chosen[::-1]


FOLDER = "layout"  # of the search, what `optimize` writes


def with_layout(study: FollowStudy, wanted: Wanted, work: WorkFolder, progress: Progress) -> FollowStudy:
    """Return the study with the design that a search finds for shapes at some instants, the last among them, as poses
    that share one layout. It goes on in its own folder. Raises InputError where the rig cannot drive it."""
    choice = study.layout
    assert choice is not None
    count = len(wanted.times)
    moments = np.unique(np.linspace(count - 1, -1, min(choice.instants, count) + 1)[:-1].round().astype(int))
    targets = tuple(_target(study, wanted, int(moment), work) for moment in moments)
    limits = StudyLimits((0.0, float(regulator_of(study).highest.min())), choice.spacing, choice.edge, choice.seconds)
    search = Study(
        f"{study.name}: layout", study.design, targets, study.model, study.seed, positions=True,
        muscles=choice.muscles, limits=limits, order=study.order,
    )  # fmt: skip
    simulator = Simulator(study.points_per_side)

    def show(at: Evaluations) -> None:
        progress(f"a layout for shapes at rest: {at.best_in_words}", 0.0)

    result = run_study(search, work.folder / FOLDER, forward=simulator, coarse=Simulator(COARSE), progress=show)
    if result.interrupted:
        raise KeyboardInterrupt
    channels = result.design.channels
    if study.rig.channels is not None and channels > study.rig.channels:
        raise InputError(f"{study.name}: the layout has {channels} channels; the rig has {study.rig.channels}")
    return replace(study, design=result.design)


def _target(study: FollowStudy, wanted: Wanted, moment: int, work: WorkFolder) -> TargetFile:
    """Return what is wanted at an instant, as a search's target."""
    if isinstance(study.target, tuple):
        return study.target[moment].target
    name = f"instant_{moment}.npz"
    work.claim(name)
    file: Path = work.folder / name
    write_arrays(file, {"points": wanted.targets[moment].points})
    return replace(TargetFile(file), face=study.target.face, weighting=study.target.weighting)
