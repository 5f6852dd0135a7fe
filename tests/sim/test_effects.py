"""Each effect by its signature (closed forms where there are), at off, beside others, and what it leaves behind.

The closed forms are those of one muscle of a linear law, F = PULL p / 100 kPa - STIFFNESS eps, that shortens a cloth in
its plane (bending is out of the question): F = K eps, with K from the motion without the effect.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fabdesign.effects import BUILT_IN, EFFECTS
from fabdesign.effects.acting import acting_pressure, observed, specimen_of
from fabdesign.effects.learned import formula
from fabdesign.effects.pneumatics import lagged
from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.lag import first_order
from fabdesign.nouns.model import EffectTerm, Model, Quantity
from fabdesign.nouns.muscle import Muscle
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram
from sim import Simulator
from sim.grid import node_means
from tests.sim_designs import cloth, held, laced, linear_muscle, middle

SIMULATOR = Simulator(points_per_side=11)
PULL, STIFFNESS = 2.0, 60.0  # N at 100 kPa, N
STILL = {"gravity": (0.0, 0.0, 0.0)}


def puller(*, intervals=1, path=((0.1, 0.0), (0.1, 0.2)), channels=1):
    """A stiff cloth without weight and muscles of the linear law down its middle."""
    kind = linear_muscle(STIFFNESS, PULL, axis_offset=0.0)
    muscles = [Muscle("linear", "front", channel, path, 0.2 / intervals) for channel in range(channels)]
    return cloth(*muscles, types={"linear": kind}, bending_stiffness=(1.0, 1.0), **STILL)


def stepped(time, kpa):
    """One channel's set points [kPa] from each of `time` [s] on."""
    return PressureProgram(np.asarray(time, float), 1e3 * np.asarray(kpa, float)[:, None], 1.0)


def with_effects(case, *terms):
    return replace(case, effects=terms)


def pressure_seen(motion):
    """(T, intervals) Pa that act in muscles of the linear law."""
    return (motion.tension.astype(float) + STIFFNESS * motion.contraction) / PULL * 1e5


# --- the pressure that acts


def test_lag_is_an_exponential_that_empties_as_it_is_told():
    # p = P (1 - exp(-t / fill)), then P exp(-t / empty): means over ticks are differences of the integral
    tick, fill, empty = 0.01, 0.05, 0.2
    set_points = np.repeat([[100e3], [0.0]], 50, axis=0)
    t = tick * np.arange(51)
    up = 100e3 * (t + fill * np.expm1(-t / fill))
    top = -100e3 * np.expm1(-0.5 / fill)
    down = -top * empty * np.expm1(-t / empty)
    expected = np.concatenate([np.diff(up), np.diff(down)]) / tick
    assert lagged(set_points, tick, fill, empty)[:, 0] == pytest.approx(expected, rel=1e-9)


def test_a_first_order_lag_is_exact_and_may_fall_slower_than_it_rises():
    path = first_order([1.0, 0.0], [0.1, 0.3], 0.1, start=0.0, falling=0.3)
    risen = 1 - np.exp(-1)
    assert path == pytest.approx([0.0, risen, risen * np.exp(-1)], rel=1e-12)
    both = first_order(np.array([[1.0, 2.0], [0.0, 4.0]]), [0.1, 0.2], 0.1, start=np.zeros(2))
    assert both[1] == pytest.approx([risen, 2 * risen], rel=1e-12)
    assert both[2] == pytest.approx([risen * np.exp(-2), 4 + (2 * risen - 4) * np.exp(-2)], rel=1e-12)


def test_lagged_pressure_acts_in_the_muscle():
    times = np.array([0.02, 0.05, 0.1, 0.2, 0.3, 0.35, 0.4, 0.5])
    case = Case(puller(), stepped([0.0, 0.2], [200, 0]))
    lag = Term("filling_lag", {"fill": 0.05, "empty": 0.15})
    [motion] = SIMULATOR.run([with_effects(case, lag)], [times])
    top = 200e3 * -np.expm1(-0.2 / 0.05)
    expected = np.where(times <= 0.2, -200e3 * np.expm1(-times / 0.05), top * np.exp(-(times - 0.2) / 0.15))
    assert pressure_seen(motion)[:, 0] == pytest.approx(expected, abs=6e3)  # means over steps of 1/240 s


def test_dead_time_shifts_the_motion():
    times, delay = np.array([0.01, 0.03, 0.06, 0.1]), 96 / 1920  # s: whole ticks, so that steps are the same
    case = held(laced("cross", 2), (200, 50))
    late = with_effects(case, Term("dead_time", {"delay": delay}))
    shifted, plain = SIMULATOR.run([late, case], [np.r_[0.04, times + delay], np.r_[0.0, times]])
    assert np.abs(plain.middle[-1] - plain.middle[0]).max() > 5e-3
    assert np.abs(shifted.middle - plain.middle).max() < 2e-5
    # a lag before it is shifted as it is
    terms = Term("filling_lag", {"fill": 0.05}), Term("dead_time", {"delay": delay})
    lagging, both = (acting_pressure(with_effects(case, *t), 400, 1 / 1920).means for t in (terms[:1], terms))
    assert both[96:] == pytest.approx(lagging[:-96], abs=1.0) and np.abs(both[:96]).max() < 1e-6


def test_droop_grows_with_the_open_channels():
    design, share = puller(channels=3), 0.1
    programs = [(200, 0, 0), (200, 4, 0), (200, 100, 0), (200, 100, 50)]  # 4 kPa is not open
    cases = [with_effects(held(design, kpa), Term("supply_droop", {"share": share})) for kpa in programs]
    seen = [pressure_seen(motion)[-1, 0] for motion in SIMULATOR.run(cases, [np.array([0.1])] * 4)]
    assert seen == pytest.approx([200e3, 200e3, 180e3, 160e3], rel=2e-3)


def test_line_loss_falls_from_a_path_s_first_point():
    n, share = 5, 0.4
    ways = (((0.1, 0.0), (0.1, 0.2)), ((0.1, 0.2), (0.1, 0.0)))
    cases = [with_effects(held(puller(intervals=n, path=w), (200,)), Term("line_loss", {"share": share})) for w in ways]
    down, up = SIMULATOR.run(cases, [np.array([0.5])] * 2)
    expected = 200e3 * (1 - share * (np.arange(n) + 0.5) / n)
    assert pressure_seen(down)[0] == pytest.approx(expected, rel=2e-3)  # at hold, too
    assert pressure_seen(up)[0] == pytest.approx(expected, rel=2e-3)  # so the inlet is at the other end
    assert down.contraction[0, 0] > 1.2 * up.contraction[0, -1]  # of one place


def test_threshold_is_one_curve_of_the_pressure():
    # w log(1 + exp((p - threshold) / w)), alike going up and down
    threshold, width, kpa = 40.0, 10.0, [5, 30, 40, 60, 200, 60, 30]
    case = Case(puller(), stepped(0.1 * np.arange(7), kpa))
    [motion] = SIMULATOR.run([with_effects(case, Term("threshold_pressure"))], [0.1 * np.arange(1, 8) - 0.01])
    w = width * np.tanh(threshold / width)
    expected = 1e3 * w * np.log1p(np.exp((np.array(kpa) - threshold) / w))
    assert pressure_seen(motion)[:, 0] == pytest.approx(expected, rel=2e-3, abs=300.0)
    assert 1e3 * width * np.log(2) == pytest.approx(expected[2], rel=2e-3)  # hardly narrower, as on the rig


# --- constants and the rest state


def test_softening_grows_from_trial_to_trial():
    case, orders = with_effects(held(puller(), (200,)), Term("stroke_softening", {"loss": 0.3})), [0, 1, 3, 30]
    motions = SIMULATOR.run([replace(case, order=k) for k in orders], [np.array([0.1])] * 4)
    expected = 200e3 * (1 - 0.3 * -np.expm1(-np.array(orders) / 3))
    assert [pressure_seen(motion)[-1, 0] for motion in motions] == pytest.approx(expected, rel=2e-3)


def test_added_mass_stretches_the_cloth_above_it():
    # without contraction across, the mean tension along v above the mass is m g / width: the hem sinks by m g v / k w
    m, v = 0.02, 0.147
    case = held(cloth(poisson=0.0), ())
    heavy = with_effects(case, Term("added_mass", {"u": 0.131, "v": v, "mass": m}))
    [start], [plain] = (SIMULATOR.run([c], [np.zeros(1)]) for c in (heavy, case))
    sunk = (plain.middle - start.middle)[0, -1, :, 1].astype(float)
    assert np.average(sunk, weights=np.r_[0.5, np.ones(9), 0.5]) == pytest.approx(m * 9.81 * v / (520 * 0.2), rel=0.02)
    assert sunk[6] > 1.2 * sunk[1]  # more on its own side


def test_stiffening_everywhere_is_a_stiffer_cloth():
    factor, shape = 1.8, {"u": 0.1, "v": 0.1, "radius": 2.0}
    front = laced("cross", 2, support="clamped", gravity=(0.0, -7.0, -7.0), membrane_stiffness=(520.0, 400.0))
    alike = dict.fromkeys(("membrane", "shear", "bending"), factor)
    stiff = with_effects(held(front, (200, 50)), Term("local_stiffening", shape | {"factor": factor}))
    cases = [stiff, held(front, (200, 50), **alike), held(front, (200, 50))]
    one, other, plain = SIMULATOR.run(cases, [np.array([0.0, 0.02, 0.05])] * 3)
    assert np.abs(one.middle - other.middle).max() < 5e-5
    assert np.abs(one.middle - plain.middle).max() > 2e-3


def test_a_stiff_disc_has_its_area_on_any_grid():
    design, disc = cloth(), Term("local_stiffening", {"u": 0.08, "v": 0.11, "radius": 0.03, "factor": 3.0})
    for n in (11, 41):
        stiffer = node_means(specimen_of(with_effects(held(design, ()), disc)), "stiffer", n).reshape(n, n)
        at, areas = np.linspace(0, 0.2, n), np.full((n, n), (0.2 / (n - 1)) ** 2)
        total = (stiffer * areas).sum()
        assert total == pytest.approx(2 * np.pi * 0.03**2, rel=0.01)
        middle_at = (stiffer.sum(axis=0) @ at / stiffer.sum(), stiffer.sum(axis=1) @ at / stiffer.sum())
        assert middle_at == pytest.approx((0.08, 0.11), abs=0.1 * 0.2 / (n - 1))


def test_tilted_cloth_hangs_along_gravity():
    # a pinned straight sheet turns about its edge: by the tilt, rigidly
    case = held(cloth(), ())
    tilted = with_effects(case, Term("frame_tilt", {"about_x": 4.0}))
    plain, leaning = (middle(shape) for shape in SIMULATOR.equilibria([case, tilted]))
    a = np.radians(4.0)
    expected = plain @ np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]]).T
    assert np.abs(leaning - expected).max() < 1e-4
    [start] = SIMULATOR.run([tilted], [np.zeros(1)])
    assert np.abs(start.middle[0] - expected[::4, ::4]).max() < 1e-4  # and so it starts


def test_curled_cloth_without_weight_is_a_cylinder():
    # y = -sin(k v) / k, z = (1 - cos(k v)) / k, and nothing is strained: of second order in the spacing
    k, apart = 5.0, []
    case = with_effects(held(cloth(support="clamped", **STILL), ()), Term("rest_curvature", {"across": 0.0, "down": k}))
    for n in (11, 21):
        [start] = Simulator(points_per_side=n).run([case], [np.zeros(1)])
        v = np.linspace(0, 0.2, n)
        expected = np.stack([-np.sin(k * v) / k, (1 - np.cos(k * v)) / k], axis=-1)
        apart.append(np.abs(start.middle[0, ..., 1:] - expected[:, None]).max())
    assert apart[0] < 1e-4 and 2.5 < apart[0] / apart[1] < 5.5


def test_curl_flips_with_the_cloth():
    # front muscles on a cloth curled one way mirror back muscles on one curled the other way
    curl = {"across": 1.0, "down": 2.0, "twist": 0.5}
    front = laced("cross", 2)
    back = replace(front, muscles=tuple(replace(muscle, side="back") for muscle in front.muscles))
    cases = [
        with_effects(held(front, (200, 50)), Term("rest_curvature", curl)),
        with_effects(held(back, (200, 50)), Term("rest_curvature", {k: -value for k, value in curl.items()})),
    ]
    one, other = SIMULATOR.run(cases, [np.array([0.0, 0.1])] * 2)
    assert np.abs(one.middle - other.middle * np.array([1, 1, -1], np.float32)).max() < 1e-5
    assert np.abs(one.middle[0, ..., 2]).max() > 0.01  # and it is curled where it starts


@pytest.mark.parametrize("angle", ["about_x", "about_z"])
def test_tilt_is_a_turned_gravity(angle):
    a, times = np.radians(3.0), [np.array([0.03])]
    gravity = (0, -np.cos(a), -np.sin(a)) if angle == "about_x" else (np.sin(a), -np.cos(a), 0)
    turned = laced("cross", 2, gravity=tuple(float(9.81 * g) for g in gravity))
    tilted = with_effects(held(laced("cross", 2), (100, 0)), Term("frame_tilt", {"about_x": 0.0, angle: 3.0}))
    [one], [other] = (SIMULATOR.run([case], times) for case in (tilted, held(turned, (100, 0))))
    assert np.abs(one.middle - other.middle).max() < 1e-6


def test_orthotropy_is_a_cloth_with_those_values():
    ratio, times = 1.7, [np.array([0.03, 0.08])]
    root = ratio**0.5
    declared = laced("cross", 2)
    changed = laced(
        "cross", 2, membrane_stiffness=(520 * root, 520 / root), bending_stiffness=(0.006 * root, 0.006 / root),
        poisson=0.25 * root,
    )  # fmt: skip
    effect = with_effects(held(declared, (200, 50)), Term("orthotropy", {"ratio": ratio}))
    one, other = SIMULATOR.run([effect, held(changed, (200, 50))], times * 2)
    assert np.abs(one.middle - other.middle).max() < 1e-6
    [plain] = SIMULATOR.run([held(declared, (200, 50))], times)
    assert np.abs(one.middle - plain.middle).max() > 1e-4


def test_odd_muscle_is_one_that_pulls_so():
    weak = linear_muscle(STIFFNESS, 0.7 * PULL, name="weak", axis_offset=0.0)
    two = puller(channels=2)
    muscles = (two.muscles[0], replace(two.muscles[1], type="weak"))
    mixed = replace(two, muscles=muscles, muscle_types={**two.muscle_types, "weak": weak})
    odd = with_effects(held(two, (200, 300)), Term("odd_muscle", {"channel": 1.0, "factor": 0.7}))
    one, other = SIMULATOR.run([odd, held(mixed, (200, 300))], [np.array([0.1])] * 2)
    assert one.tension == pytest.approx(other.tension, rel=1e-3)
    assert pressure_seen(one)[0] == pytest.approx([200e3, 0.7 * 300e3], rel=1e-3)


# --- forces with memory


def test_creep_is_the_standard_linear_solid():
    # K eps = P - k (eps - z), tau dz/dt = s eps - z: z = z_end (1 - exp(-t / tau')), tau' = tau / (1 - s k / (k + K))
    share, tau, times = 0.3, 0.1, np.array([0.1, 0.2, 0.4, 0.8])
    case = held(puller(), (200,))
    crept = with_effects(case, Term("muscle_creep", {"share": share, "time": tau}))
    slow, plain = SIMULATOR.run([crept, case], [times] * 2)
    force, elastic = 2 * PULL, plain.contraction[-1, 0]
    remainder = 1 - share * STIFFNESS * elastic / force  # 1 - s k / (k + K)
    z = share * elastic / remainder * -np.expm1(-times * remainder / tau)
    expected = elastic * (1 + STIFFNESS * z / force)
    assert slow.contraction[:, 0] == pytest.approx(expected, rel=0.01)
    assert expected[-1] > 1.1 * elastic
    [rest] = SIMULATOR.equilibria([crept])  # at its limit
    end = (rest.reshape(2, 41, 41, 3)[:, -1, 20, 1]).mean() + 0.2
    [bare] = SIMULATOR.equilibria([case])
    assert end / ((bare.reshape(2, 41, 41, 3)[:, -1, 20, 1]).mean() + 0.2) == pytest.approx(1 / remainder, rel=0.01)


def test_a_law_from_a_bench_that_held_each_point_has_the_creep_at_rest_and_lacks_it_at_once():
    # at once K eps = P - k (1 + s) eps, in the end K eps = P - k eps
    share, case = 0.6, held(puller(), (200,))
    slow = with_effects(case, Term("muscle_creep", {"share": share, "time": 0.5, "on_bench": 1.0}))
    early, late, plain = SIMULATOR.run([slow, slow, case], [np.array([0.02]), np.array([5.0]), np.array([0.1])])
    elastic = plain.contraction[-1, 0]
    softer = STIFFNESS * elastic / (2 * PULL)  # k / (k + K)
    assert late.contraction[-1, 0] == pytest.approx(elastic, rel=2e-3)
    assert early.contraction[-1, 0] == pytest.approx(elastic / (1 + share * softer), rel=0.02)


def test_relaxation_is_one_prony_term():
    # K (eps - s z) = P - k eps, tau dz/dt = eps - z: as creep's closed form, with K for k
    share, tau, times = 0.4, 0.1, np.array([0.1, 0.2, 0.4, 0.8])
    case = held(puller(), (200,))
    relaxed = with_effects(case, Term("stress_relaxation", {"share": share, "time": tau}))
    slow, plain = SIMULATOR.run([relaxed, case], [times] * 2)
    elastic = plain.contraction[-1, 0]
    part = share * (1 - STIFFNESS * elastic / (2 * PULL))  # s K / (k + K)
    z = elastic / (1 - part) * -np.expm1(-times * (1 - part) / tau)
    assert slow.contraction[:, 0] == pytest.approx(elastic + part * z, rel=0.01)
    assert part * z[-1] > 0.1 * elastic


def test_a_relaxed_cloth_rests_as_a_softer_one():
    share, sheet = 0.3, cloth(support="clamped", gravity=(0.0, -7.0, -7.0))
    softer = dict.fromkeys(("membrane", "shear", "bending"), 1 - share)
    relaxed = with_effects(held(sheet, ()), Term("stress_relaxation", {"share": share, "time": 0.5}))
    one, other, plain = (
        middle(shape) for shape in SIMULATOR.equilibria([relaxed, held(sheet, (), **softer), held(sheet, ())])
    )
    assert np.abs(one - other).max() < 1e-4
    assert np.abs(one - plain).max() > 5e-3
    [start] = SIMULATOR.run([relaxed], [np.zeros(1)])
    assert np.abs(start.middle[0] - other[::4, ::4]).max() < 1e-4  # and so it starts: it has hung for long


def test_viscosity_differs_by_direction():
    # c d eps/dt = P - (k + K) eps: exponentials, with another time constant going back
    into, back, times = 20.0, 50.0, np.array([0.1, 0.2, 0.4, 0.7, 0.9])
    plain = puller()
    bare = replace(plain, fabric=replace(plain.fabric, viscosity=0.0, air_damping=0.0))
    slow = Case(bare, stepped([0.0, 0.5], [200, 0]), effects=(
        Term("muscle_viscosity", {"contracting": into, "lengthening": back}),
    ))  # fmt: skip
    [motion], [settled] = SIMULATOR.run([slow], [times]), SIMULATOR.run([held(plain, (200,))], [np.array([0.4])])
    elastic = settled.contraction[0, 0]
    stiffness = 2 * PULL / elastic  # k + K
    top = elastic * -np.expm1(-0.5 * stiffness / into)
    up, down = -elastic * np.expm1(-times * stiffness / into), top * np.exp(-(times - 0.5) * stiffness / back)
    assert motion.contraction[:, 0] == pytest.approx(np.where(times <= 0.5, up, down), rel=0.02)
    assert down[-1] > 0.1 * elastic


FRICTION, SLIP = 0.4, 0.001  # N, 1
HYSTERESIS = Term("braid_hysteresis", {"friction": 0.0, "friction_at_zero": FRICTION, "slip": SLIP})


def triangle(seconds, peak=200.0, rows=40):
    """Up to `peak` kPa and down again within `seconds`."""
    up = np.linspace(0, peak, rows + 1)
    return stepped(np.arange(2 * rows + 1) * seconds / (2 * rows), np.r_[up, up[-2::-1]])


def test_hysteresis_opens_branches_as_wide_at_any_rate():
    # going up P - k eps - f = K eps, going down P - k eps + f: 2 f / (k + K) apart at equal pressure
    contraction = []
    for seconds in (0.4, 0.8):
        case, times = Case(puller(), triangle(seconds)), np.array([0.25, 0.75]) * seconds + seconds / 160
        rubbed, plain = SIMULATOR.run([with_effects(case, HYSTERESIS), case], [times] * 2)
        contraction.append(rubbed.contraction[:, 0] - plain.contraction[:, 0])
    [settled] = SIMULATOR.run([held(puller(), (200,))], [np.array([0.4])])
    width = 2 * FRICTION * settled.contraction[0, 0] / (2 * PULL)  # 2 f / (k + K)
    for up, down in contraction:
        assert up == pytest.approx(-width / 2, rel=0.05)
        assert down == pytest.approx(width / 2, rel=0.05)
    assert contraction[0] == pytest.approx(contraction[1], rel=0.03)


def test_hysteresis_has_minor_loops_and_stays_open_at_hold():
    # back by less than 2 f / (f / slip + k + K) of contraction it sticks: the slope is that of the stuck element
    rows = [(0.0, 0), (0.2, 150), (0.3, 150), (0.4, 140), (0.5, 140), (0.6, 150), (0.7, 150), (0.8, 200), (0.9, 150)]
    fine = np.linspace(0, 0.9, 91)
    case = Case(puller(), stepped(fine, np.interp(fine, *zip(*rows, strict=True))))
    times = np.array([0.3, 0.5, 0.7, 1.0, 1.4])  # each at the end of a hold
    rubbed, plain = SIMULATOR.run([with_effects(case, HYSTERESIS), case], [times] * 2)
    up, back, again, down, later = rubbed.contraction[:, 0].astype(float)
    soft = 1.5 * PULL / plain.contraction[-1, 0]  # k + K
    assert up - back == pytest.approx(0.1 * PULL / (soft + FRICTION / SLIP), rel=0.1)
    assert again == pytest.approx(up, abs=0.05 * (down - up))  # the minor loop closes
    assert down - up == pytest.approx(2 * FRICTION / soft, rel=0.05)  # both at 150 kPa
    assert later == pytest.approx(down, abs=0.01 * (down - up))
    # growing with pressure: f = friction p
    grows = Term("braid_hysteresis", {"friction": FRICTION / 150, "friction_at_zero": 0.0, "slip": SLIP})
    [motion] = SIMULATOR.run([with_effects(case, grows)], [times[:1]])
    assert motion.contraction[0, 0] == pytest.approx(up, abs=0.03 * (down - up))


def test_a_hold_of_no_time_keeps_friction():
    cases = [with_effects(held(puller(), (200,)), HYSTERESIS), held(puller(), (200,))]
    short, bare = (middle(shape)[-1, 20, 1] + 0.2 for shape in replace(SIMULATOR, hold=0.0).equilibria(cases))
    assert short / bare == pytest.approx(1 - FRICTION / (2 * PULL), abs=0.01)  # as far as its rise drove it


def test_drag_has_a_falling_sheet_s_terminal_speed():
    # m dv/dt = m g - c v^2: fallen by v_e^2 / g log cosh(g t / v_e), v_e^2 = m g / c
    c, g, mass, times = 3.0, 9.81, 0.6, np.array([0.1, 0.2, 0.4])
    sheet = cloth(hung="none", gravity=(0.0, 0.0, -g), viscosity=0.0, air_damping=0.0)
    case = with_effects(held(sheet, ()), Term("air_drag", {"coefficient": c}))
    [motion] = SIMULATOR.run([case], [times])
    limit = (mass * g / c) ** 0.5
    expected = limit**2 / g * np.log(np.cosh(g * times / limit))
    assert -motion.middle[:, 5, 5, 2] == pytest.approx(expected, rel=5e-3)
    assert expected[-1] < 0.9 * g * 0.4**2 / 2


# --- what is observed


def test_time_offset_is_predicted_and_not_simulated():
    case, times = held(laced("cross", 2), (200, 50)), [np.array([0.02, 0.05, 0.1])]
    model = Model(effects=(EffectTerm("time_offset", {"offset": Quantity(0.03, "s")}),))
    [predicted] = Predictor(SIMULATOR, model, sensing=True).motions([case], times)
    [simulated] = Predictor(SIMULATOR, model).motions([case], times)
    [plain] = SIMULATOR.motions([case], times)
    [earlier] = SIMULATOR.motions([case], [np.array([0.0, 0.02, 0.07])])
    assert np.array_equal(simulated, plain)
    assert np.abs(predicted - earlier).max() < 1e-7
    assert np.abs(predicted - plain).max() > 1e-3


def test_clouds_are_turned_shifted_and_scaled():
    turns, shift = {"about_x": 3.0, "about_y": -2.0, "about_z": 5.0}, {"x": 0.01, "y": -0.02, "z": 0.005}
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (3, 7, 3))
    case = with_effects(PLAIN, Term("registration_bias", turns | shift), Term("scale_error", {"scale": 0.03}))
    turn = Rotation.from_euler("xyz", list(turns.values()), degrees=True).as_matrix()
    expected = 1.03 * (points @ turn.T + list(shift.values()))
    assert observed(case, points) == pytest.approx(expected, abs=1e-12)
    other = replace(case, effects=case.effects[::-1])
    assert observed(other, points) == pytest.approx(1.03 * points @ turn.T + list(shift.values()), abs=1e-12)
    # predicted and not simulated
    cases, times = [replace(PLAIN, effects=case.effects)], [TIMES]
    [seen], [moved] = (Predictor(SIMULATOR, Model(), sensing=s).motions(cases, times) for s in (True, False))
    [plain] = SIMULATOR.motions([PLAIN], times)
    assert np.array_equal(moved, plain)
    assert np.abs(seen - 1.03 * (plain @ turn.T + list(shift.values()))).max() < 1e-6


# --- all of them

TIMES = np.array([0.05, 0.1])
PLAIN = Case(
    laced("cross", 2),
    PressureProgram(np.array([0.0, 0.04]), np.array([[200e3, 50e3], [100e3, 50e3]]), 0.1),
    order=3,
)


def test_off_are_the_bits_without():
    off = [Term(name, {key: EFFECTS[name].parameters[key].off for key in EFFECTS[name].strengths}) for name in BUILT_IN]
    cases = [PLAIN, *(with_effects(PLAIN, term) for term in off), with_effects(PLAIN, *off)]
    bare, *others = SIMULATOR.run(cases, [TIMES] * len(cases))
    assert all(np.array_equal(other.middle, bare.middle) for other in others)


COEFFICIENTS = {"stroke": 20.0, "rate": 5.0, "quick": 0.3}
GIVEN = {"learned": COEFFICIENTS, "discovered": COEFFICIENTS}  # off by default


def test_lanes_keep_their_bits_and_leave_nothing():
    names = [n for n in BUILT_IN if EFFECTS[n].site != "sensing"]
    cases = [PLAIN, *(with_effects(PLAIN, Term(name, GIVEN.get(name, {}))) for name in names)]
    bare, *together = SIMULATOR.run(cases, [TIMES] * len(cases))
    for name, case, beside in zip(names, cases[1:], together, strict=True):
        [alone] = SIMULATOR.run([case], [TIMES])
        assert np.array_equal(alone.middle, beside.middle), name
        assert np.abs(beside.middle - bare.middle).max() > 2e-5, name
    [again] = SIMULATOR.run([PLAIN], [TIMES])
    assert np.array_equal(again.middle, bare.middle)


# of the prior's deviation, by site or name: over the solver's noise, which differs between processors
SIZES = {
    "pneumatics": 0.05,
    "environment": 0.5,
    "added_mass": 0.05,
    "muscle_creep": 0.8,
    "learned.drag": 0.5,
    "discovered.drag": 0.5,
}
SHAPES = {"muscle_creep": {"time": 0.03}, "stress_relaxation": {"time": 0.03}}  # s: seen within TIMES
EMPTIED = replace(  # muscles lengthen
    PLAIN, program=PressureProgram(np.array([0.0, 0.03]), np.array([[200e3, 50e3], [0.0, 0.0]]), 0.1)
)


def test_derivative_at_off_exists():
    # one-sided differences of two sizes agree
    cases, names = [], []
    for name in BUILT_IN:
        for key in EFFECTS[name].strengths:
            parameter = EFFECTS[name].parameters[key]
            zero = SHAPES.get(name, {}) | {k: EFFECTS[name].parameters[k].off for k in EFFECTS[name].strengths}
            step = SIZES.get(f"{name}.{key}", SIZES.get(name, SIZES.get(EFFECTS[name].site, 0.2)))
            case = EMPTIED if key == "lengthening" else PLAIN
            cases.append(case)
            for share in (step, step / 2):
                moved = share * parameter.deviation
                value = parameter.off * np.exp(moved) if parameter.transform == "log" else parameter.off + moved
                cases.append(with_effects(case, Term(name, zero | {key: value})))
            names.append(f"{name}.{key}")
    motions = Predictor(SIMULATOR, Model(), sensing=True).motions(cases, [TIMES] * len(cases))
    for name, base, one, half in zip(names, motions[::3], motions[1::3], motions[2::3], strict=True):
        slopes = [(m.astype(float) - base).ravel() / size for m, size in ((one, 2), (half, 1))]
        gap = np.linalg.norm(slopes[0] - slopes[1]) / np.linalg.norm(slopes[1])
        assert gap < 0.15, name


# --- what is learned is each of the effects that it stands for

ALIKE = {
    "quick": ({"quick": 1.0}, Term("filling_lag", {"fill": 0.1, "empty": 0.1})),
    "slow": ({"slow": 1.0}, Term("filling_lag", {"fill": 0.5, "empty": 0.5})),
    "drawn": ({"drawn": 0.06}, Term("supply_droop", {"share": 0.06})),
    "far": ({"far": 0.4}, Term("line_loss", {"share": 0.4})),
    "rate": ({"rate": 12.0}, Term("muscle_viscosity", {"contracting": 12.0, "lengthening": 12.0})),
    "curvatures": (
        {"across": 0.5, "down": 1.0, "twist": -0.4},
        Term("rest_curvature", {"across": 0.5, "down": 1.0, "twist": -0.4}),
    ),
    "friction": ({"friction": 0.5}, Term("braid_hysteresis", {"friction": 0.0, "friction_at_zero": 0.5})),
    "drag": ({"drag": 20.0}, Term("air_drag", {"coefficient": 20.0})),
    "ratio": ({"ratio": float(np.log(1.5))}, Term("orthotropy", {"ratio": 1.5})),
}


@pytest.mark.parametrize("name", ALIKE)
def test_a_coefficient_is_the_effect_that_it_stands_for(name):
    coefficients, effect = ALIKE[name]
    case = replace(PLAIN, program=PressureProgram(np.zeros(1), np.array([[200e3, 200e3]]), 0.1))
    cases = [with_effects(case, term) for term in (Term("learned", coefficients), effect)]
    bare, learned, named = (motion.middle for motion in SIMULATOR.run([case, *cases], [TIMES] * 3))
    change = np.abs(named - bare).max()
    assert np.abs(learned - named).max() < 0.01 * change > 2e-7


def test_a_formula_says_what_coefficients_add():
    assert formula({"bend": 0.123, "drawn": 0.05, "spring": -3.0, "ratio": 0.0}) == (
        "p -0.05 p (sum of the other channels / 200 kPa) +0.123 p (p / 200 kPa - 1); T -3 N e"
    )
    assert formula(dict.fromkeys(EFFECTS["learned"].parameters, 1.0)).count("1") >= 14
    assert formula({}) == ""


def test_what_is_discovered_is_learned_and_adds_to_it():
    half, coefficients = {"stroke": 10.0, "down": 0.5}, {"stroke": 20.0, "down": 1.0}
    both = replace(PLAIN, effects=(Term("learned", half), Term("discovered", half)))
    cases = [both, *(with_effects(PLAIN, Term(name, coefficients)) for name in ("learned", "discovered"))]
    added, learned, discovered = (motion.middle for motion in SIMULATOR.run(cases, [TIMES] * 3))
    np.testing.assert_array_equal(learned, discovered)
    np.testing.assert_allclose(added, learned, atol=1e-6)


def test_a_learned_pressure_is_not_in_proportion_to_the_set_point():
    program = PressureProgram(np.zeros(1), np.array([[400e3, 0.0]]), 0.1)
    case = replace(PLAIN, program=program, effects=(Term("learned", {"bend": 0.1}),))
    assert acting_pressure(case, 4, 1e-3).means[-1] == pytest.approx([440e3, 0.0])


def test_what_is_learned_adds_to_named_effects_in_either_order():
    learned = Term("learned", {"down": 0.5, "far": 0.1, "friction": 0.2, "drag": 2.0, "ratio": 0.1, "quick": 0.5})
    named = (
        Term("rest_curvature", {"down": 1.0}),
        Term("line_loss", {"share": 0.2}),
        Term("braid_hysteresis", {"friction_at_zero": 0.3}),
        Term("air_drag", {"coefficient": 3.0}),
        Term("filling_lag", {"fill": 0.1, "empty": 0.2}),
    )
    program = PressureProgram(np.zeros(1), np.array([[400e3, 100e3]]), 0.1)
    before, after = (replace(PLAIN, program=program, effects=terms) for terms in ((learned, *named), (*named, learned)))
    one, other = specimen_of(before), specimen_of(after)
    assert one.constants == other.constants and one.constants["rest_curvature_down"] == pytest.approx(1.5)
    assert one.constants["air_drag"] == pytest.approx(5.0)
    for name, expected in (("pressure_loss", 0.3), ("friction_at_zero", 0.5)):
        assert one.muscles[name] == pytest.approx(expected) and other.muscles[name] == pytest.approx(expected)
    pressures = [acting_pressure(case, 4, 1e-3).means for case in (before, after)]
    assert (pressures[0] == pressures[1]).all()
