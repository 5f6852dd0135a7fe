"""No more muscles than needed: those that do nothing or the same go, at a tolerance or for a price."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case
from fabdesign.nouns.muscle import Muscle
from fabdesign.study_files.study_file import MuscleChoice, Study, read_study
from fabdesign.study_files.study_targets import Price, TargetFile
from optimize.search.best import Stage
from optimize.search.design_space import DesignSpace, Limits, with_shared_channels
from optimize.search.evaluations import Evaluations
from optimize.search.history import History
from optimize.search.multistart import search
from optimize.search.objective import Objective, Target
from optimize.search.search_state import load_state, save_state
from optimize.search.starts import Start
from optimize.search.thinning import Fewer, fewer_muscles
from optimize.search.variations import pulling, with_idle
from studies.layouts.refinement import fewer_in_words, shrunk
from studies.layouts.run import run_study
from tests.analytic_cloth import AnalyticCloth

CLOTH = build("vertical")
LIMITS = Limits()
STUDY = Study("s", CLOTH, ())


def layout(*places: tuple[float, float], pressures: list[float]) -> Start:
    """Upright muscles on the front at (u, length) m under pressures in kPa."""
    first = CLOTH.muscles[0]
    muscles = tuple(
        replace(first, channel=k, path=((u, 0.02), (u, 0.02 + length))) for k, (u, length) in enumerate(places)
    )
    space = DesignSpace(replace(CLOTH, muscles=muscles), LIMITS, 1e3 * np.array([pressures]), vary_positions=True)
    return space, space.encode(space.design, space.start_pressures)


TWO = layout((0.05, 0.15), (0.15, 0.12), pressures=[320, 210])


def cloud_of(start: Start) -> np.ndarray:
    design, pressures = start[0].decode(start[1])
    return AnalyticCloth(21).equilibria([Case(design, constant_program(pressures[0]))])[0].astype(float)


def leave_out(start: Start, price: Price, least: int = 1, target: Start = TWO) -> Fewer:
    coarse, fine = AnalyticCloth(11), AnalyticCloth(21)
    stages = [Stage("layouts", coarse, keep=1, rounds=9, vary_positions=True)]
    stages.append(Stage("full model", fine, keep=1, rounds=9, vary_positions=True, slopes=coarse))
    with History(":memory:", "a") as history:
        cloud = Target(np.random.default_rng(1).normal(cloud_of(target), 6e-4))
        evaluations = Evaluations(Objective([cloud]), [start], stages, history, seconds=600, evaluations=9000)
        [(value, _)] = evaluations.evaluate(1, [(0, start[1])])
        thinned = fewer_muscles(evaluations, least=least, price=price)
        assert evaluations.best is not None
        assert (evaluations.best.start, evaluations.best.value) == (0, value)
        assert len(evaluations.starts) == 1  # what was tried is forgotten
        values = [value for _, value in evaluations.reached.front]
        assert values == sorted(values, reverse=True) and evaluations.reached.front[-1][1] <= min(value, thinned.value)
    return thinned


def test_an_idle_muscle_and_one_that_does_the_same_go() -> None:
    four = layout((0.05, 0.15), (0.10, 0.1), (0.145, 0.12), (0.155, 0.12), pressures=[320, 0, 160, 160])
    thinned = leave_out(four, Price())
    assert (thinned.count, len(thinned.start[0].design.muscles)) == (4, 2)
    assert thinned.value <= 1.03 * thinned.before
    assert thinned.start[0].feasible(thinned.start[1])
    kept = leave_out(four, Price(), least=3)
    assert len(kept.start[0].design.muscles) == 3


def test_what_is_needed_stays_unless_a_price_pays_for_it() -> None:
    thinned = leave_out(TWO, Price())
    assert len(thinned.start[0].design.muscles) == 2
    assert thinned.ended == "no smaller layout is near enough" and not thinned.cut
    paid = leave_out(TWO, Price(muscle=0.2))  # m: no muscle is worth that
    assert len(paid.start[0].design.muscles) == 1


def test_channels_are_shared_where_pressures_agree() -> None:
    start = layout((0.05, 0.15), (0.1, 0.1), (0.15, 0.12), pressures=[300, 100, 310])
    shared = with_shared_channels(start)
    assert shared is not None and with_shared_channels(TWO) is None
    space, x = shared
    design, pressures = space.decode(x)
    assert [muscle.channel for muscle in design.muscles] == [0, 1, 0]
    np.testing.assert_allclose(pressures, [[305e3, 100e3]])


def test_a_muscle_more_is_idle_or_pulls_and_keeps_the_limits() -> None:
    more = with_idle(TWO, count=4, sides=("front", "back"), number=8, seed=1)
    assert len(more) == 8
    for (space, x), (_, pulled) in zip(more, pulling(more, 2, 0.4), strict=True):
        design, pressures = space.decode(x)
        assert space.feasible(x) and len(design.muscles) == 4
        np.testing.assert_allclose(pressures, [[320e3, 210e3, 0, 0]], atol=1e-6)
        np.testing.assert_allclose(space.decode(pulled)[1], [[320e3, 210e3, 160e3, 160e3]])
    assert len({space.design.muscles for space, _ in more}) == 8
    assert [x.tolist() for _, x in with_idle(TWO, count=2, sides=("front",), number=8, seed=1)] == [TWO[1].tolist()]


def test_what_is_not_needed_goes_while_the_muscles_stay() -> None:
    """A corner that bends nothing, and a channel for a pressure that another one has."""
    space, x = layout((0.05, 0.15), (0.15, 0.12), pressures=[265, 265])
    first, second = space.design.muscles
    bent = replace(first, path=(first.path[0], (0.052, 0.09), first.path[1]))
    bent_space = replace(space, design=replace(space.design, muscles=(bent, second)))
    start = bent_space, bent_space.encode(bent_space.design, bent_space.start_pressures)
    thinned = leave_out(start, Price(), least=2, target=(space, x))
    design, pressures = thinned.start[0].decode(thinned.start[1])
    assert [len(muscle.path) for muscle in design.muscles] == [2, 2]
    assert [muscle.channel for muscle in design.muscles] == [0, 0] and pressures.shape == (1, 1)
    assert not thinned.ended and thinned.value <= 1.03 * thinned.before
    assert fewer_in_words(STUDY, thinned).startswith("The 2 muscles, straight, are enough on 1 channel:")
    fewer = replace(thinned, count=3, value=1.068e-3, before=1.071e-3)
    where = "2 muscles on 1 channel are enough, where the search came to 3"
    assert fewer_in_words(STUDY, fewer) == f"{where}: 1.07 mm with either."
    nearer = replace(fewer, before=1.05e-3)
    assert fewer_in_words(STUDY, nearer) == f"{where}: 1.07 mm instead of 1.05 mm, within 3% of it."


@pytest.fixture
def study(tmp_path: Path) -> Study:
    np.savetxt(tmp_path / "target.xyz", cloud_of(TWO))
    spare: Muscle = replace(CLOTH.muscles[0], channel=2, path=((0.1, 0.05), (0.1, 0.15)))
    design: Design = replace(TWO[0].design, muscles=(*TWO[0].design.muscles, spare))
    return replace(
        Study("s", design, (TargetFile(tmp_path / "target.xyz"),), muscles=MuscleChoice(1, 3), positions=True),
        start_pressures=np.array([320e3, 210e3, 0.0]),
    )


def test_a_study_says_how_few_would_do_and_does_not_try_it_twice(study: Study, tmp_path: Path) -> None:
    limits = replace(study.limits, evaluations=900)
    study = replace(study, limits=limits)
    run_study(study, tmp_path / "out", forward=AnalyticCloth(21))
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["fewer"]["muscles"] == len(result["muscles"]) == 2
    front = result["fewer"]["front"]
    assert front[-1]["objective_mm"] <= result["fewer"]["before_mm"] and {row["muscles"] for row in front} <= {1, 2, 3}
    assert result["after_a_tenth_mm"] >= result["fewer"]["before_mm"]
    calls: list[int] = []
    again = run_study(study, tmp_path / "out", forward=AnalyticCloth(21), progress=lambda _: calls.append(1))
    assert not calls
    assert again.to_json()["fewer"] == result["fewer"]
    assert again.to_json()["pressures_kpa"] == pytest.approx(result["pressures_kpa"])


def test_going_on_keeps_what_a_number_of_muscles_came_to(study: Study) -> None:
    coarse, fine = AnalyticCloth(11), AnalyticCloth(21)
    stages = [Stage("layouts", coarse, keep=1, rounds=3, vary_positions=True)]
    stages.append(Stage("full model", fine, keep=1, rounds=3, vary_positions=True, slopes=coarse))
    bare = layout((0.05, 0.15), (0.15, 0.12), (0.1, 0.1), pressures=[300, 230, 20])
    objective = Objective([Target(cloud_of(TWO))])
    with History(":memory:", "a") as history:
        before = Evaluations(objective, [bare], stages, history, seconds=600, evaluations=9000)
        search(before)
        fewer = shrunk(study, before)
        after = Evaluations(objective, [bare], stages, history, seconds=900, evaluations=9000)
        save_state(after, load_state(after, None))  # what a round of the search that goes on keeps
        assert (
            fewer is not None
            and len(fewer.front) > 1
            and after.reached.front == before.reached.front == list(fewer.front)
        )
        again = shrunk(study, after)
    assert again is not None
    assert len(again.start[0].design.muscles) <= len(fewer.start[0].design.muscles) and again.value <= fewer.value


@pytest.mark.parametrize(
    ("table", "problem"),
    [("[price]\nmuscle = -1\n", "muscle"), ("[price]\ncost = 1\n", "cost"), ("[robust]\nchoose = 1\n", "choose")],
)
def test_bad_tables_are_refused(tmp_path: Path, table: str, problem: str) -> None:
    (tmp_path / "t.xyz").write_text("0 0 0\n")
    write_design(CLOTH, tmp_path / "d.toml")
    head = 'format = "fabdesign.study/1"\nkind = "optimize"\ndesign = "d.toml"\n[target]\nfile = "t.xyz"\n'
    (tmp_path / "s.toml").write_text(head + table)
    with pytest.raises(InputError, match=problem):
        read_study(tmp_path / "s.toml")
