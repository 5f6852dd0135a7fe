"""The design space: what it maps, and the limits that it measures."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from fabdesign.study_files.study_file import MuscleChoice
from optimize.search.design_space import DesignSpace
from optimize.search.margins import Limits, bend_radius, clearance, constraint_margins
from optimize.search.starts import layout_starts, pressure_starts, thinned_starts

BASIC = build("basic")
coordinates = st.floats(0.0, 0.2)
points = st.tuples(coordinates, coordinates)


def with_paths(*paths: tuple[tuple[float, float], ...]) -> Design:
    muscles = tuple(Muscle("EM20", "front", i, path, 0.02) for i, path in enumerate(paths))
    return replace(BASIC, muscles=muscles)


def test_a_vector_stands_for_a_design_and_its_pressures() -> None:
    space = DesignSpace(BASIC, Limits(), np.full((2, 8), 100e3), vary_positions=True)
    rng = np.random.default_rng(1)
    x = rng.random(space.dimension)
    design, pressures = space.decode(x)
    assert space.dimension == 8 * 4 + 2 * 8
    assert pressures.shape == (2, 8)
    np.testing.assert_allclose(space.encode(design, pressures), x, atol=1e-12)
    corners = np.concatenate([muscle.path for muscle in design.muscles])
    assert corners.min() >= 0.005
    assert corners.max() <= 0.195


def test_what_does_not_vary_stays_the_same_object() -> None:
    pressures = np.full((1, 8), 120e3)
    design, held = DesignSpace(BASIC, Limits(), pressures, vary_pressures=False).decode(np.empty(0))
    assert design is BASIC
    assert held is pressures


def test_shared_channels_are_one_variable() -> None:
    shared = replace(BASIC, muscles=tuple(replace(muscle, channel=muscle.channel % 2) for muscle in BASIC.muscles))
    assert DesignSpace(shared, Limits(), np.zeros((1, 2))).dimension == 2


@given(points, points, points, points)
def test_clearance_is_the_least_distance_of_two_segments(
    p: tuple[float, float], q: tuple[float, float], r: tuple[float, float], s: tuple[float, float]
) -> None:
    a, b, c, d = np.array([p, q, r, s])
    t = np.linspace(0, 1, 201)[:, None]
    sampled = np.linalg.norm((a + t * (b - a))[:, None] - (c + t * (d - c))[None], axis=2).min()
    distance = clearance(np.array([a, b]), np.array([c, d]))
    spacing = (np.linalg.norm(b - a) + np.linalg.norm(d - c)) / 200  # how far a sample may lie from the nearest place
    if distance >= 0:
        assert distance <= sampled + 1e-12
        assert sampled <= distance + spacing + 1e-12
    else:
        assert sampled <= spacing


def test_a_right_angle_is_rounded_by_its_shorter_leg() -> None:
    # tangent length = R tan(turn / 2) with turn = 90 degrees: R = the leg
    assert bend_radius(np.array([[0.0, 0.0], [0.05, 0.0], [0.05, 0.12]])) == pytest.approx(0.05)
    # a leg between two corners serves half and half
    assert bend_radius(np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.04], [0.2, 0.04]])) == pytest.approx(0.02)
    assert bend_radius(np.array([[0.0, 0.0], [0.1, 0.0], [0.2, 0.0]])) > 1e6


def test_margins_say_how_far_each_limit_is() -> None:
    kind = replace(BASIC.muscle_types["EM20"], stock_length=0.2, tail_length=0.01, min_bend_radius=0.03)
    design = replace(
        with_paths(((0.02, 0.02), (0.02, 0.18)), ((0.05, 0.02), (0.05, 0.1), (0.13, 0.1))), muscle_types={"EM20": kind}
    )
    margins = constraint_margins(design, np.array([[100e3, 380e3]]), Limits(spacing=0.006))
    assert margins["spacing"] == pytest.approx(0.03 - 0.006)
    assert margins["stock_length"] == pytest.approx(0.2 - 2 * 0.01 - 0.16)
    assert margins["min_bend_radius"] == pytest.approx(0.08 - 0.03)
    assert margins["inside_cloth"] == pytest.approx(0.02)
    assert margins["pressure"] == pytest.approx(20e3)


def test_crossing_muscles_on_one_face_break_the_spacing_and_on_two_do_not() -> None:
    crossed = with_paths(((0.02, 0.1), (0.18, 0.1)), ((0.1, 0.04), (0.1, 0.18)))
    pressures = np.zeros((1, 2))
    # the least shift that parts them is the shortest end: 0.06 m up
    assert constraint_margins(crossed, pressures, Limits(spacing=0.006))["spacing"] == pytest.approx(-0.06 - 0.006)
    first, second = crossed.muscles
    apart = replace(crossed, muscles=(first, replace(second, side="back")))
    assert "spacing" not in constraint_margins(apart, pressures, Limits())


@pytest.mark.parametrize("seed", range(3))
def test_drawn_layouts_keep_the_limits(seed: int) -> None:
    limits = Limits(spacing=0.02, pressure=(50e3, 300e3))
    starts = layout_starts(BASIC, limits, 1, MuscleChoice(1, 4, ("front",)), number=40, seed=seed)
    assert len(starts) == 40
    assert {len(space.design.muscles) for space, _ in starts} == {1, 2, 3, 4}
    for space, x in starts:
        design, pressures = space.decode(x)
        assert min(constraint_margins(design, pressures, limits).values()) >= -1e-9
        assert {muscle.side for muscle in design.muscles} == {"front"}


def test_the_same_seed_draws_the_same_starts() -> None:
    space = DesignSpace(BASIC, Limits(), np.full((1, 8), 200e3))
    one, two, other = (pressure_starts(space, 16, seed) for seed in (3, 3, 4))
    assert all(np.array_equal(a[1], b[1]) for a, b in zip(one, two, strict=True))
    assert not np.array_equal(one[1][1], other[1][1])


def test_thinned_starts_are_the_design_s_own_muscles_under_their_pressures():
    design, pressures = build("basic"), 1e3 * np.arange(1, 9).reshape(1, 8)
    every = thinned_starts(DesignSpace(design, Limits(), pressures), 7, number=10, seed=1)
    left_out = set()
    for space, x in every:
        thinned, kept_pressures = space.decode(x)
        assert [muscle.channel for muscle in thinned.muscles] == list(range(7))
        kept = [int(p / 1e3) - 1 for p in kept_pressures[0].round()]
        assert [m.path for m in thinned.muscles] == [design.muscles[k].path for k in kept]
        left_out |= set(range(8)) - set(kept)
    assert len(every) == 8 and left_out == set(range(8))
    some = thinned_starts(DesignSpace(design, Limits(), pressures), 4, number=20, seed=1)
    assert len(some) == 20 and len({tuple(space.decode(x)[1][0].round()) for space, x in some}) == 20
