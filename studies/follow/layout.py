"""The layout of a study that leaves it open: the one whose shapes at rest come nearest to some of what is wanted."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from fabdesign.nouns.design import Design
from fabdesign.output import WorkFolder
from fabdesign.runtime.store import write_arrays
from fabdesign.study_files.follow_file import FollowStudy
from fabdesign.study_files.study_file import Study, StudyLimits
from fabdesign.study_files.study_targets import TargetFile
from optimize.search.evaluations import Evaluations
from sim import Simulator
from studies.follow.programs import Regulator
from studies.follow.wanted import Wanted
from studies.layout_search.first_layouts import COARSE
from studies.layouts import run_study

FOLDER = "layout"  # of the search, what `optimize` writes


def chosen_layout(
    study: FollowStudy, wanted: Wanted, regulator: Regulator, work: WorkFolder, progress: Callable[[Evaluations], None]
) -> Design:
    """Return the design that a search finds for shapes at some instants, the last among them, as poses that share one
    layout. It goes on in its own folder."""
    choice = study.layout
    assert choice is not None
    count = len(wanted.times)
    moments = np.unique(np.linspace(count - 1, 0, min(choice.instants, count + 1))[:-1].round().astype(int))
    targets = tuple(_target(study, wanted, int(moment), work) for moment in moments)
    limits = StudyLimits((0.0, float(regulator.highest.min())), choice.spacing, choice.edge, choice.seconds)
    search = Study(
        f"{study.name}: layout", study.design, targets, study.model, study.seed, positions=True,
        muscles=choice.muscles, limits=limits, order=study.order,
    )  # fmt: skip
    simulator = Simulator(study.points_per_side)
    result = run_study(search, work.folder / FOLDER, forward=simulator, coarse=Simulator(COARSE), progress=progress)
    if result.interrupted:
        raise KeyboardInterrupt
    return result.design


def _target(study: FollowStudy, wanted: Wanted, moment: int, work: WorkFolder) -> TargetFile:
    """Return what is wanted at an instant, as a search's target."""
    if isinstance(study.target, tuple):
        return study.target[moment].target
    name = f"instant_{moment}.npz"
    work.claim(name)
    file: Path = work.folder / name
    write_arrays(file, {"points": wanted.targets[moment].points})
    return replace(TargetFile(file), face=study.target.face, weighting=study.target.weighting)
