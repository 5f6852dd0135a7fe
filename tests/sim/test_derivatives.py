"""Derivatives of shapes at rest against the float64 reference, by kind of column; what is left to differences; those
of frames of motions in balance."""

from dataclasses import replace

import numpy as np
import pytest

from fabdesign.nouns import column
from fabdesign.nouns.forward import Instant, Term
from fabdesign.nouns.model import EffectTerm, Model, Quantity
from fabdesign.nouns.predictor import Predictor
from sim import Simulator
from studies.prediction.forward_model import without_resistance
from tests.sim.derivatives_reference import kinds, lacking, of_effect
from tests.sim_designs import cloth, held, laced

N = 11
SIMULATOR = Simulator(points_per_side=N)
CASES = [
    held(laced("side", 4), [200.0, 100.0, 150.0, 50.0]),
    held(laced("cross", 2, support="clamped", gravity=(0.0, -9.0, 3.0)), [150.0, 30.0]),
]


@pytest.fixture(scope="module")
def jacobians():
    return SIMULATOR.shape_jacobian(CASES, kinds())


@pytest.mark.parametrize("which", range(len(CASES)))
def test_columns_of_shapes_follow_the_reference(jacobians, which):
    middle, changes, exact = jacobians[which]
    assert exact.all()
    assert changes.shape == (len(kinds()), N, N, 3)
    off = dict(zip((kind.name for kind in kinds()), lacking(CASES[which], kinds(), middle, changes), strict=True))
    if CASES[which].design.fabric.support == "clamped":
        del off["rest_curvature down"]  # the reference's clamp knows no rest curvature
    assert off == pytest.approx(dict.fromkeys(off, 0.0), abs=3e-3)


def test_differences_of_shapes_follow_the_tangent(jacobians):
    # the reference path: whole shapes, whose rest is loose
    columns = [column.factor("bending"), column.pressure(0)]
    [plain] = SIMULATOR.shape_differences(CASES[:1], columns)
    assert not plain.exact.any()
    names = [kind.name for kind in kinds()]
    for kind, change in zip(columns, plain.changes, strict=True):
        exact = jacobians[0].changes[names.index(kind.name)]
        assert np.linalg.norm(change - exact) < 0.05 * np.linalg.norm(exact)


def test_a_shape_that_buckles_is_said_and_takes_differences():
    # a soft cloth that stands on its hem: straight up is an equilibrium, and not a stable one
    standing = held(cloth(gravity=(0.0, 9.81, 0.0), bending_stiffness=(1e-4, 1e-4)))
    columns = [of_effect("rest_curvature", "down", 0.1)]  # which bends it; its weight alone would not
    [jacobian] = SIMULATOR.shape_jacobian([standing], columns)
    [plain] = SIMULATOR.shape_differences([standing], columns)
    assert not jacobian.exact.any()
    assert np.array_equal(jacobian.changes, plain.changes, equal_nan=True)  # NaN where a moved shape falls over
    assert not (jacobian.changes == 0).all()


def test_effects_that_add_forces_take_differences_where_they_are_off_too():
    creep = of_effect("muscle_creep", "share", 0.1)
    [jacobian] = SIMULATOR.shape_jacobian(CASES[:1], [column.factor("bending"), creep])
    assert jacobian.exact.tolist() == [True, False]
    assert np.abs(jacobian.changes[1]).max() > 1e-4


def test_slopes_without_resistance_are_exact_and_near():
    """A search's: braid friction and drag hold little of a shape at rest, and have no tangent."""
    friction = EffectTerm("braid_hysteresis", {"friction": Quantity(0.002, "N/kPa")})
    model = Predictor(
        SIMULATOR, Model(effects=(friction, EffectTerm("air_drag", {"coefficient": Quantity(1.0, "N s^2/m^4")})))
    )
    bare = without_resistance(model)
    assert bare is not None and bare.model.effects == () and without_resistance(bare) is None
    columns = [column.factor("bending"), column.pressure(0)]
    [plain], [approximation] = (one.faces_jacobian(CASES[:1], columns) for one in (model, bare))
    assert not plain.exact.any() and approximation.exact.all()
    for true, change in zip(plain.changes, approximation.changes, strict=True):
        assert 0 < np.linalg.norm(change - true) < 0.15 * np.linalg.norm(true)


def polynomial(offsets, values):
    """Value, velocity and acceleration at 0 of a cubic through values at offsets [s]."""
    rows = np.linalg.pinv(np.vander(offsets, 4, increasing=True))
    return [np.tensordot(scale * row, values.astype(float), 1) for scale, row in zip((1, 1, 2), rows, strict=False)]


FINE, FRAMES = np.arange(-2, 3) / 160, np.arange(-2, 3) / 30  # s


MOVED = {"muscle_gain": 0.05, "bending": 0.1, "areal_density": 0.2, "damping": 0.3}
FRICTION = Term("braid_hysteresis", {"friction": 0.002})


def balance_of(case, others, columns, *, at=0.35):
    """Return how far off the motions of others are at an instant, what of that their velocity and acceleration leave,
    and what the columns do: (others, N, N, 3) m each."""
    course = np.unique(np.concatenate([np.arange(0.0, at, 1 / 80), at + FINE]))
    base, fine, coarse, *seen = SIMULATOR.run(
        [case, case, case, *others], [course, at + FINE] + [at + FRAMES] * (1 + len(others))
    )
    offs = [other.middle.astype(float) - coarse.middle for other in seen]
    moved = [[part[None] for part in (off[2], *polynomial(FRAMES, off)[1:])] for off in offs]
    instants = [Instant(at, *polynomial(FINE, fine.middle), *parts) for parts in moved]
    [balances] = SIMULATOR.balances([case], [column.Course(course, base.middle, instants)], columns)
    off = np.array([off[2] for off in offs])
    remaining = off - [balance.responses[0] for balance in balances]
    return off, remaining, np.array([balance.changes[k] for k, balance in enumerate(balances)])


@pytest.mark.parametrize(("effects", "most"), [((), (0.1, 0.2, 0.6, 0.5)), ((FRICTION,), (0.1, 0.2, 0.8, 0.6))])
def test_a_moved_motion_is_in_balance_with_what_moved_it(effects, most):
    """K d = F dtheta - C d' - M d'', with d to the motion under another factor: beside velocity and acceleration the
    column takes most of d. A friction is as the motion has led to, and stays so."""
    case = replace(CASES[0], effects=effects)
    others = [replace(case, factors={name: 1 + by}) for name, by in MOVED.items()]
    offs, remaining, changes = balance_of(case, others, [column.factor(name) for name in MOVED])
    for (name, by), share, off, rest, change in zip(MOVED.items(), most, offs, remaining, changes, strict=True):
        assert np.linalg.norm(rest) > 0.25 * np.linalg.norm(off), name
        assert np.linalg.norm(rest - by * change) < share * np.linalg.norm(rest), name


@pytest.mark.parametrize(
    ("effect", "values", "moved", "most"),
    [
        ("muscle_creep", {"share": 0.4, "time": 0.3}, {"share": 0.5, "time": 0.4}, 0.15),
        ("braid_hysteresis", {"friction": 0.003, "slip": 0.005}, {"friction": 0.004}, 0.03),
    ],
)
def test_what_muscles_remember_is_in_balance_by_the_law_of_their_bench(effect, values, moved, most):
    """The force follows from the contractions along the motion, whose changes are small beside what moved them."""
    case = replace(CASES[0], effects=(Term(effect, values),))
    others = [replace(case, effects=(Term(effect, {**values, name: value}),)) for name, value in moved.items()]
    _, remaining, changes = balance_of(case, others, [of_effect(effect, name, 1e-3) for name in moved])
    for (name, value), rest, change in zip(moved.items(), remaining, changes, strict=True):
        imbalance = np.linalg.norm(rest - (value - values[name]) * change)
        assert imbalance < most * np.linalg.norm(rest), name


def test_damping_moves_no_shape_at_rest():
    """What is left of the velocity on the way there is no motion."""
    [jacobian] = SIMULATOR.shape_jacobian(CASES[:1], [column.factor("damping")])
    assert jacobian.exact.all() and not jacobian.changes.any()


def test_a_frame_that_is_not_there_has_no_balance():
    nothing = np.full((N, N, 3), np.nan)
    course = column.Course(
        np.array([0.0, 0.1]), np.zeros((2, N, N, 3)), [Instant(0.1, *[nothing] * 3, *[nothing[None]] * 3)]
    )
    [[balance]] = SIMULATOR.balances(CASES[:1], [course], [column.factor("bending")])
    assert np.isnan(balance.responses).all() and np.isnan(balance.changes).all()


def test_a_moved_corner_keeps_its_intervals_or_stays():
    case = held(laced(), [0.0] * 4)
    muscle = case.design.muscles[0]
    for by in (-0.012, 0.012):
        moved = column.corner(0, 1, (0.0, 1.0)).moved(case, by).design.muscles[0]
        assert len(moved.fixed_points()) == len(muscle.fixed_points())
        assert moved.path[1][1] == pytest.approx(muscle.path[1][1] + by)
    angled = replace(muscle, path=((0.05, 0.05), (0.05, 0.0749), (0.05, 0.09)), fixed_point_pitch=0.01)
    case = held(replace(case.design, muscles=(angled,)), [0.0])
    assert column.corner(0, 1, (0.0, 1.0)).moved(case, 0.002) == case
