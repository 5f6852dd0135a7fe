"""Restarts: what a search begins with, when it may say that it converged, and what it says of its result."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.files.pressure_file import constant_program, write_pressures
from fabdesign.geometry.metrics import Errors
from fabdesign.geometry.surface import pierced
from fabdesign.nouns.catalogue import LAYOUTS, build
from fabdesign.nouns.muscle import Muscle
from fabdesign.study_files.study_file import MuscleChoice, Study, StudyLimits, read_study
from optimize.search.design_space import DesignSpace, Limits
from optimize.search.history import History
from optimize.search.multistart import search
from optimize.search.starts import Start, pressure_starts
from optimize.search.variations import straightened, variations, with_corners
from studies.layout_search.first_layouts import first_starts
from studies.layouts.reach import Reach, reach_of
from tests.search.test_search import DESIGN, SPACE, Interrupted, best_pressures, drawn_anew, within

LIMITS = Limits()
EIGHT = MuscleChoice(1, 8)


def study_of(**changes: object) -> Study:
    return replace(Study("s", build("basic"), (Path("target.npz"),), muscles=EIGHT, positions=True), **changes)


def test_the_own_design_and_the_layouts_of_the_catalogue_are_among_the_starts() -> None:
    starts = first_starts(study_of())
    layouts = [(space.design.muscles, pressures) for space, x in starts for _, pressures in [space.decode(x)]]
    assert layouts[0][0] == build("basic").muscles
    for layout in set(LAYOUTS) - {"cross"}:  # whose muscles cross on one face, closer than the spacing allows
        muscles = build(layout, muscles=8).muscles
        levels = [
            pressures.max() for other, pressures in layouts if np.allclose(_paths(other), _paths(muscles), 0, 1e-4)
        ]
        assert {200e3, 400e3} <= {float(round(level)) for level in levels}, layout


def _paths(muscles: Sequence[Muscle]) -> np.ndarray:
    """(8, 5): ends and side; of other counts nothing alike."""
    if len(muscles) != 8:
        return np.full((8, 5), np.inf)
    return np.array([[*m.path[0], *m.path[-1], m.side == "front"] for m in muscles])


def test_variations_keep_the_limits_and_differ() -> None:
    space = DesignSpace(build("basic"), LIMITS, np.full((2, 8), 300e3), vary_positions=True)
    x = space.encode(space.design, space.start_pressures)
    variants = variations((space, x), MuscleChoice(6, 9, corners=0), number=40, seed=3)
    assert len(variants) > 30
    assert all(variant.feasible(y) for variant, y in variants)
    assert {len(variant.design.muscles) for variant, _ in variants} >= {7, 8, 9}
    same = [len(variant.design.muscles) == 8 and np.allclose(y, x) for variant, y in variants]
    assert sum(same) < len(variants) / 4
    again = variations((space, x), MuscleChoice(6, 9, corners=0), number=40, seed=3)
    assert all(np.array_equal(a[1], b[1]) for a, b in zip(variants, again, strict=True))


def test_muscles_get_corners_and_lose_them() -> None:
    space = DesignSpace(build("vertical"), LIMITS, np.full((1, 3), 300e3), vary_positions=True)
    best = space, space.encode(space.design, space.start_pressures)
    assert with_corners(best, 0) == [] and straightened(best) is None
    [(bent, x)] = with_corners(best, 1)
    design, pressures = bent.decode(x)
    np.testing.assert_allclose(
        [m.path[1] for m in design.muscles], [np.mean(m.path, axis=0) for m in space.design.muscles]
    )
    np.testing.assert_allclose([m.length for m in design.muscles], [m.length for m in space.design.muscles])
    np.testing.assert_allclose(pressures, 300e3)
    assert with_corners((bent, x), 1) == []
    straight = straightened((bent, x))
    assert straight is not None
    np.testing.assert_allclose(straight[1], best[1], atol=1e-9)
    drawn = variations(best, MuscleChoice(3, 3, ("front",)), number=40, seed=1)
    assert {len(m.path) for variant, _ in drawn for m in variant.design.muscles} == {2, 3}
    assert all(variant.feasible(y) for variant, y in drawn)
    without_corners = variations((bent, x), MuscleChoice(3, 3, ("front",), corners=0), number=40, seed=1)
    assert any(len(m.path) == 2 for variant, _ in without_corners for m in variant.design.muscles)


def test_variations_of_the_best_cannot_agree_with_it() -> None:
    def around_best(restart: int, best: Start) -> tuple[list[Start], bool]:
        return pressure_starts(SPACE, 3, seed=restart)[1:], False

    with History(":memory:", "a") as history:
        reason = search(within(history, evaluations=400, starts=0), further=around_best)
    assert reason.startswith("nothing gained: 3 rounds of restarts")


def test_a_search_ends_where_new_starts_agree() -> None:
    with History(":memory:", "a") as history:
        searched = within(history)
        assert search(searched, further=drawn_anew).startswith("converged: 3 searches from different starts")
        full = [entry.objective for entry in history.entries() if entry.stage == "full model"]
    assert searched.best is not None
    assert searched.best.value == min(full)  # a later restart's coarse values take nothing away
    with History(":memory:", "a") as history:
        assert search(within(history)).startswith("ended")  # one restart agrees with nothing


def test_a_search_ends_at_the_floor() -> None:
    with History(":memory:", "a") as history:
        assert search(within(history), floor=lambda shape: 1.0).startswith("at the floor")
    with History(":memory:", "a") as history:
        assert search(within(history), floor=lambda shape: 1e-6).startswith("ended")


def test_a_search_killed_in_a_later_campaign_goes_on_to_the_same_end(tmp_path: Path) -> None:
    with History(tmp_path / "whole.sqlite", "a") as history:
        uninterrupted = within(history)
        reason = search(uninterrupted, further=drawn_anew)
    for call in (12, 20):
        with History(tmp_path / f"{call}.sqlite", "a") as history, pytest.raises(SystemExit):
            search(within(history, forward=Interrupted(call, SystemExit)), further=drawn_anew)
        with History(tmp_path / f"{call}.sqlite", "a") as history:
            resumed = within(history)
            assert search(resumed, further=drawn_anew) == reason, call
        np.testing.assert_array_equal(best_pressures(resumed), best_pressures(uninterrupted))


@pytest.fixture
def earlier(tmp_path: Path) -> Path:
    """A study file beside an earlier result of one pose."""
    (tmp_path / "old").mkdir()
    write_design(DESIGN, tmp_path / "old" / "design.toml")
    write_design(DESIGN, tmp_path / "design.toml")
    write_pressures(constant_program([300e3, 100e3, 0.0]), tmp_path / "old" / "pressures.csv")
    (tmp_path / "cloud.ply").write_text("ply\n")
    text = 'kind = "optimize"\ndesign = "design.toml"\nstart = "old"\n[target]\nfile = "cloud.ply"\n'
    (tmp_path / "study.toml").write_text(text + "[variables]\nmuscles = { max = 4 }\n")
    return tmp_path / "study.toml"


def test_an_earlier_result_is_the_first_start(earlier: Path) -> None:
    space, x = first_starts(read_study(earlier))[0]
    assert space.design.muscles == DESIGN.muscles
    np.testing.assert_allclose(space.decode(x)[1], [[300e3, 100e3, 0.0]])


def test_an_earlier_result_that_is_no_layout_of_the_study_is_refused(earlier: Path) -> None:
    with pytest.raises(InputError, match="old: has 3 muscles; expected 1 to 2"):
        first_starts(replace(read_study(earlier), muscles=MuscleChoice(1, 2)))
    earlier.write_text(earlier.read_text().replace('"old"', '"none"'))
    with pytest.raises(InputError, match="the folder of an earlier result"):
        read_study(earlier)


def _reach(pressures: Sequence[float], chamfer: float, shape: np.ndarray, most: int = 4) -> Reach:
    study = Study("s", DESIGN, (), muscles=MuscleChoice(1, most), positions=True, limits=StudyLimits())
    errors = Errors(chamfer, 4e-3, 1e-3, 1e-3)
    return reach_of(study, DESIGN, np.array([pressures]), shape[None], errors, {"spacing": 1e-5})


def sheet(bend: float) -> np.ndarray:
    """(2 * 41 * 41, 3) m: a cloth of 0.2 m bent by `bend` turns down its length, 1 mm thick."""
    turn = 2 * np.pi * bend * np.linspace(0, 1, 41)
    step = 0.2 / 40
    z, y = np.cumsum(np.sin(turn)) * step, -np.cumsum(np.cos(turn)) * step
    x = np.linspace(-0.1, 0.1, 41)
    faces = []
    for s in (5e-4, -5e-4):
        rows = [np.tile(c[:, None], (1, 41)) for c in (y + s * np.sin(turn), z + s * np.cos(turn))]
        faces.append(np.stack([np.tile(x, (41, 1)), *rows], axis=-1).reshape(-1, 3))
    return np.concatenate(faces)


def test_what_holds_a_result_back_is_said() -> None:
    flat = sheet(0.0)
    reach = _reach([400e3, 400e3, 399e3], 9e-3, flat, most=3)
    assert reach.out_of_reach
    assert reach.sentences == [
        "Out of reach: 5.0 mm over the noise floor. What holds it back: all muscles at 400 kPa, all 3 muscles used, "
        "spacing at its limit."
    ]
    assert _reach([400e3, 0.0, 100e3], 9e-3, flat).held_by == ("1 of 3 muscles at 400 kPa", "spacing at its limit")
    assert not _reach([400e3, 400e3, 400e3], 4.5e-3, flat).out_of_reach


def test_a_cloth_that_passes_through_itself_is_found() -> None:
    assert pierced(sheet(0.0)) is None
    assert pierced(sheet(0.9)) is None  # nearly a whole turn: its end comes near its top
    crossed = _crossed()
    u, v = pierced(crossed)
    assert 0.28 < v < 0.74  # an edge of either layer: at 0.3 and 0.72 of the height
    assert 0.2 < u < 0.8
    assert "passes through itself" in _reach([0.0, 0.0, 0.0], 4e-3, crossed).sentences[0]


def _crossed() -> np.ndarray:
    """A sheet folded back so that its lower half cuts the upper one at an angle."""
    v = np.linspace(0, 0.2, 41)
    upper = v < 0.1
    y = np.where(upper, -v, -0.1 + 0.9 * (v - 0.1))
    z = np.where(upper, 0.0, 0.02 - 0.45 * (v - 0.1))
    x = np.linspace(-0.1, 0.1, 41)
    middle = np.stack([np.tile(x, (41, 1)), np.tile(y[:, None], (1, 41)), np.tile(z[:, None], (1, 41))], -1)
    return np.concatenate([middle.reshape(-1, 3)] * 2)
