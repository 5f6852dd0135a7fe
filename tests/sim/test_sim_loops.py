"""Weights of the loops by which fixed points hold the cloth."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.lacing import LOOP, WIDENED, interpolation_weights, line_weights, patch_size

places = st.floats(0.0, 0.2)
grids = st.integers(9, 200)


@given(places, grids)
def test_linear_functions_are_reproduced(t, nodes):
    spacing = 0.2 / (nodes - 1)
    count = patch_size(nodes, spacing)
    first, value, slope, moment = line_weights(t, nodes, spacing, count)
    x = (first + np.arange(count)) * spacing
    assert first >= 0 and first + count <= nodes
    assert value.sum() == pytest.approx(1.0, abs=1e-9) and value @ x == pytest.approx(t, abs=1e-9)
    assert slope.sum() == pytest.approx(0.0, abs=1e-6) and slope @ x == pytest.approx(1.0, abs=1e-6)
    assert moment == pytest.approx(value * (x - t), abs=1e-12)


@given(places, st.sampled_from([9, 21, 41, 81, 161]))
def test_a_loop_is_as_broad_as_said(t, nodes):
    # (LOOP^2 + WIDENED h^2) / 3; where a hem is nearer than LOOP, that times the square of the ratio
    spacing = 0.2 / (nodes - 1)
    count = patch_size(nodes, spacing)
    first, value, _, _ = line_weights(t, nodes, spacing, count)
    x = (first + np.arange(count)) * spacing
    knots = min(LOOP, t, 0.2 - t)
    wide = 1 + WIDENED * (spacing / LOOP) ** 2
    # with knots that are no multiple of the spacing the sum over nodes is not quite the integral
    assert value @ (x - t) ** 2 == pytest.approx(wide * knots**2 / 3, rel=1e-6 if knots == LOOP else 1e-2, abs=1e-12)


def test_an_end_on_the_hem_holds_the_hem():
    for nodes in (21, 41, 81):
        first, value, _, _ = line_weights(0.2, nodes, 0.2 / (nodes - 1), 4)
        assert first == nodes - 4 and value == pytest.approx([0, 0, 0, 1], abs=1e-9)


@given(st.floats(0.011, 0.189), st.sampled_from([21, 41, 81]))
def test_slopes_are_the_derivatives_of_the_weights(t, nodes):
    spacing, step = 0.2 / (nodes - 1), 1e-7
    t = np.floor(t / spacing) * spacing + np.clip(t % spacing, 2 * step, spacing - 2 * step)  # away from the knots
    count = patch_size(nodes, spacing)
    first, _, slope, _ = line_weights(t, nodes, spacing, count)
    before, after = (line_weights(t + s, nodes, spacing, count) for s in (-step, step))
    assert before[0] == first == after[0]
    assert (after[1] - before[1]) / (2 * step) == pytest.approx(slope, abs=1e-3 / spacing)


def test_room_for_a_broader_loop_changes_nothing():
    for nodes in (21, 41):
        spacing = 0.2 / (nodes - 1)
        for t in (0.008, 0.1, 0.1013, 0.192):
            small, large = np.zeros((2, nodes)), np.zeros((2, nodes))
            for full, count in ((small, 4), (large, 8)):
                first, value, slope, _ = line_weights(t, nodes, spacing, count)
                full[:, first : first + count] = value, slope
            assert small == pytest.approx(large, abs=1e-9)


@given(st.floats(0.0, 20.0))
def test_interpolation_reproduces_quadratics(t):
    first, weight = interpolation_weights(t, 21)
    nodes = first + np.arange(4)
    assert weight @ (nodes - t) ** 2 == pytest.approx(0.0, abs=1e-9) and weight.sum() == pytest.approx(1.0)
