"""Several poses that share one layout: each takes the pressures that bring it nearest, and a muscle that serves one
pose alone is found."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.files.design_file import write_design
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.study_files.study_file import MuscleChoice, Study, read_study
from optimize.search.best import Stage
from optimize.search.design_space import DesignSpace, Limits
from optimize.search.evaluations import Evaluations
from optimize.search.history import History
from optimize.search.local_search import LocalSearch
from optimize.search.multistart import screened
from optimize.search.objective import Objective, Target
from optimize.search.starts import Start, catalogue_starts, layout_starts
from studies.layout_search.first_layouts import further_starts
from studies.layouts.run import run_study
from tests.analytic_cloth import AnalyticCloth, WithJacobian

CLOTH = build("vertical")
FRONT, BACK = (replace(CLOTH.muscles[k], side=side, channel=k) for k, side in enumerate(("front", "back")))
DESIGN = replace(CLOTH, muscles=(FRONT, BACK))
TRUTH = np.array([[320e3, 0.0], [0.0, 250e3]])
BOTH_FACES = MuscleChoice(2, 4)


class WithThreshold(WithJacobian):
    """A cloth whose muscles do nothing below a pressure, as braided ones: where one is idle there is no slope."""

    def _shape(self, case: Case, share: float) -> np.ndarray:
        pressure = 1.6 * np.maximum(case.program.pressure - 120e3, 0.0)
        return super()._shape(replace(case, program=replace(case.program, pressure=pressure)), share)


def start_under(pressures: np.ndarray, design=DESIGN) -> Start:
    space = DesignSpace(design, Limits(), np.asarray(pressures, float))
    return space, space.encode(design, space.start_pressures)


def objective_of(times: tuple[float | None, ...] = (None, None)) -> Objective:
    blank = Objective([Target(np.zeros((1, 3)), time) for time in times])
    space, x = start_under(TRUTH)
    [shapes] = blank.shapes(AnalyticCloth(11), [space.decode(x)])
    return Objective([Target(shape, time) for shape, time in zip(shapes, times, strict=True)])


def searches_of(objective: Objective, starts: list[Start]) -> list[LocalSearch]:
    with History(":memory:", "a") as history:
        stage = Stage("first", AnalyticCloth(11), keep=2, rounds=1)
        return screened(Evaluations(objective, starts, [stage], history, seconds=60, evaluations=99), 0)


@pytest.mark.parametrize("seed", [1, 4])
def test_a_muscle_for_one_pose_alone_is_found_soon(tmp_path: Path, seed: int) -> None:
    """Forward in one pose and back in the other; with the same start pressures in both it came to 4.5 and 5.7 mm."""
    (tmp_path / "s.toml").write_text(
        'kind = "optimize"\ndesign = "d.toml"\n'
        + "".join(
            f'[[targets]]\nwishes = [{{ edge = "bottom", forward = {forward} }}, {{ at = [0.1, 0.2], right = 0.0 }}]\n'
            for forward in (0.04, -0.02)
        )
        + "[variables]\nmuscles = { max = 3 }\n[limits]\nevaluations = 250\npressure = [0, 300]\n"
    )
    write_design(replace(CLOTH, muscles=()), tmp_path / "d.toml")
    study = replace(read_study(tmp_path / "s.toml"), seed=seed)
    result = run_study(study, tmp_path / "out", forward=WithThreshold(11), follow=False)
    assert result.objective < 3e-3
    assert {muscle.side for muscle in result.design.muscles} == {"front", "back"}


def test_each_pose_takes_the_nearest_of_a_layouts_shapes() -> None:
    """In the wrong poses, and in two starts: one search begins where both are right, without a simulation more."""
    objective = objective_of()
    swapped = start_under(TRUTH[::-1])
    [local] = searches_of(objective, [swapped])
    np.testing.assert_allclose(local.space.decode(local.x)[1], TRUTH)
    assert local.value == pytest.approx(0.0, abs=1e-9)
    apart = [start_under([TRUTH[0], TRUTH[0]]), start_under([[150e3, 0.0], TRUTH[1]])]
    [local] = searches_of(objective, apart)
    np.testing.assert_allclose(local.space.decode(local.x)[1], TRUTH)
    other = start_under(TRUTH, replace(DESIGN, muscles=(BACK, FRONT)))
    assert len(searches_of(objective, [swapped, other])) == 2  # two layouts


def test_a_pose_takes_no_shape_of_another_instant() -> None:
    [local] = searches_of(objective_of((None, 0.5)), [start_under(TRUTH[::-1])])
    np.testing.assert_allclose(local.space.decode(local.x)[1], TRUTH[::-1])


def test_starts_of_several_poses_pull_on_each_face_alone_in_some_pose() -> None:
    drawn = layout_starts(CLOTH, Limits(), 2, BOTH_FACES, number=60, seed=1)
    drawn += catalogue_starts(CLOTH, Limits(), 2, BOTH_FACES)
    mixed = [start for start in drawn if {muscle.side for muscle in start[0].design.muscles} == {"front", "back"}]
    assert len(mixed) > 20
    alone = 0
    for space, x in mixed:
        design, pressures = space.decode(x)
        front = np.array([muscle.side == "front" for muscle in design.muscles])
        idle = pressures[:, [muscle.channel for muscle in design.muscles]] == 0.0
        assert not np.allclose(pressures[0], pressures[1])  # no shape is computed twice
        alone += (idle[:, front].all(axis=1) ^ idle[:, ~front].all(axis=1)).any()
    assert alone > len(mixed) / 3


def test_a_muscle_more_is_tried_idle_and_pulling_in_several_poses() -> None:
    study = Study("s", DESIGN, (Path("a"), Path("b")), muscles=MuscleChoice(1, 3), positions=True)
    further = further_starts(study)
    assert further is not None
    starts, independent = further(1, start_under(TRUTH))
    levels = [space.decode(x)[1][:, 2] for space, x in starts[-32:]]  # Pa in the muscle that is new
    assert not independent
    assert {float(round(level)) for row in levels for level in row} == {0.0, 160e3}
