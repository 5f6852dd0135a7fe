"""The motion that leads to a result: what a layout that buckles either way really reaches."""

from pathlib import Path

import numpy as np
import pytest
from sheets import rolled_sheet

from fabdesign.formats.json_file import plain
from fabdesign.nouns.catalogue import build
from fabdesign.study_files.study_file import Study
from fabdesign.study_files.study_targets import TargetFile
from optimize.search.best import Stage
from optimize.search.design_space import DesignSpace
from optimize.search.evaluations import Evaluations
from optimize.search.history import History
from optimize.search.objective import Objective, Target
from studies.layout_search.target import LoadedTarget
from studies.layouts.loading_path import loading_path
from studies.layouts.report import render_report
from studies.layouts.run import study_result
from studies.prediction.forward_model import forward_model

DUO = build("basic", muscles=2)  # one on the front, one on the back
ALIKE, APART = np.array([[200e3, 200e3]]), np.array([[240e3, 160e3]])


class Buckler:
    """Rolls by the sum of both pressures, to the side of the greater; where they are alike, to `side`. `rise`: s, below
    which a motion goes to the other side."""

    def __init__(self, side: float = 1.0, rise: float = 0.0) -> None:
        self.side, self.rise = side, rise

    def _shape(self, case, turned=1.0):
        front, back = case.program.pressure[-1]
        side = np.sign(round(front - back)) or self.side * turned
        return rolled_sheet(side * (front + back) / 100e3, n=41).astype(np.float32)

    def equilibria(self, cases):
        return [self._shape(case) for case in cases]

    def motions(self, cases, times):
        return [self._shape(c, 1.0 if c.program.time[-1] > self.rise else -1.0)[None] for c in cases]


def paths(forward, target, *results):
    cloud = rolled_sheet(target, n=41)
    at_rest, shape = (np.array([rolled_sheet(turn, n=41)]) for turn in (0.0, 4.0 * forward.side))
    objective = Objective([Target(cloud)])
    return [loading_path(objective, forward, (DUO, row), shape, at_rest, rise=1.0) for row in results]


def test_a_front_and_a_back_driven_alike_are_near_a_bifurcation():
    alike, apart = paths(Buckler(), 4.0, ALIKE, APART)
    assert [copy.name for copy in alike.on_another_branch] == ["front 2% down and back up"]
    assert alike.reached and alike.sensitive and alike.motion.value < 1e-6
    assert alike.worst == alike.on_another_branch[0].value > 0.01
    assert "end at another stable shape, at worst" in alike.sentences[0]
    assert not apart.sensitive and apart.sentences[0].startswith("The rise within 1 s ends at this shape")
    assert len(apart.copies) == 6


def test_a_branch_that_the_rise_does_not_reach_is_said_to_be_so():
    [path] = paths(Buckler(-1.0), 4.0, ALIKE)  # the target is on the other side
    assert "The target lies near a stable shape that the rise within 1 s does not reach" in " ".join(path.sentences)
    assert "front 2% up and back down ends at" in " ".join(path.sentences)
    [path] = paths(Buckler(rise=5.0), 4.0, ALIKE)  # no motion ends where the search came to
    assert not path.reached and "No simple rise of the pressures reaches the shape of the search" in path.sentences[0]
    [path] = paths(Buckler(rise=0.5), 4.0, ALIKE)
    assert "a rise within 0.2 s" in [copy.name for copy in path.on_another_branch]


class Sticking(Buckler):
    """Stays on the side that it was brought to first."""

    def motions(self, cases, times):
        self.programs = [case.program for case in cases]
        first = [next(row for row in case.program.pressure if row.sum() > 0) for case in cases]
        return [
            rolled_sheet(np.sign(a - b) * case.program.pressure[-1].sum() / 100e3, n=41).astype(np.float32)[None]
            for case, (a, b) in zip(cases, first, strict=True)
        ]


def test_poses_are_also_gone_through_one_after_another():
    pressures = np.array([[240e3, 160e3], [160e3, 240e3]])
    shapes = np.array([rolled_sheet(turn, n=41) for turn in (4.0, -4.0)])
    still = np.array([rolled_sheet(0.0, n=41)] * 2)
    objective, forward = Objective([Target(shape) for shape in shapes]), Sticking()
    path = loading_path(objective, forward, (DUO, pressures), shapes, still, rise=1.0)
    assert path.reached and [copy.name for copy in path.on_another_branch] == ["the poses one after another"]
    assert forward.programs[-2].duration == 4.0 and forward.programs[-1].duration == 8.0
    last = forward.programs[-1]
    np.testing.assert_allclose(last.at(np.array([2.0, 3.9, 6.0])), pressures[[0, 0, 1]])
    assert 160e3 < last.at(np.array([4.5]))[0, 0] < 240e3


def test_a_motion_that_diverges_is_on_another_branch():
    forward = Buckler()
    forward.motions = lambda cases, times: [np.full((1, 3362, 3), np.nan, np.float32) for _ in cases]
    [path] = paths(forward, 4.0, APART)
    assert plain(path)["worst_mm"] is None and not path.reached and len(path.on_another_branch) == 6


def result_of(folder: Path, forward, *pressures):
    """Of a search that came to DUO under each of these pressures, for a target rolled to the front."""
    study, cloud = Study("duo", DUO, (TargetFile(folder / "target.ply"),)), rolled_sheet(4.0, n=41)
    spaces = [DesignSpace(DUO, study.limits, start_pressures) for start_pressures in pressures]
    starts = [(space, space.encode(DUO, space.start_pressures)) for space in spaces]
    stages = [Stage("full model", forward, keep=2, rounds=1)]
    with History(folder / "history.sqlite", {}) as history:
        evaluations = Evaluations(Objective([Target(cloud)]), starts, stages, history, seconds=100, evaluations=100)
        evaluations.evaluate(0, [(k, x) for k, (_, x) in enumerate(starts)])
        assert evaluations.best.start == 0 and len(evaluations.finalists()) == len(pressures)
        model = forward_model(forward, None)  # as a study makes it
        return study_result(study, (LoadedTarget(cloud, description="rolled"),), evaluations, model, "ended")


def test_of_designs_equally_near_one_with_a_sure_loading_path_wins(tmp_path: Path) -> None:
    result = result_of(tmp_path, Buckler(), ALIKE, APART)
    np.testing.assert_allclose(result.pressure, APART)
    assert not result.to_json()["way"]["hangs_on_it"]


def test_no_further_layout_is_moved_than_is_needed_or_the_time_allows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forward, asked = Buckler(), []
    motions = forward.motions
    monkeypatch.setattr(forward, "motions", lambda cases, times: asked.append(len(cases)) or motions(cases, times))
    for name, layouts, batches in (("first", (APART, ALIKE), [7]), ("both", (ALIKE, APART), [7, 7])):
        (tmp_path / name).mkdir()
        result_of(tmp_path / name, forward, *layouts)
        assert asked == batches
        asked.clear()
    monkeypatch.setattr("studies.layouts.run.FOLLOWING", -1.0)
    np.testing.assert_allclose(result_of(tmp_path, forward, ALIKE, APART).pressure, ALIKE)
    assert asked == [7]


def test_what_is_reported_is_what_the_motion_reaches(tmp_path: Path) -> None:
    result = result_of(tmp_path, Buckler(rise=5.0), ALIKE)  # at rest in front, where no motion leads
    assert result.to_json()["way"]["reached"] is False
    assert result.objective == pytest.approx(result.loading_path.motion.value) and result.objective > 0.01
    assert "No simple rise of the pressures reaches" in render_report("duo", {"duo": result})
