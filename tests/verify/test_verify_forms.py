"""Closed forms and boundary-value solutions, Poisson 0 where the form has no Poisson ratio."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import brentq, fsolve

from fabdesign.nouns.muscle import BenchTable, Muscle, MuscleType
from fabdesign.nouns.muscle_law import MuscleLaw
from sim import Simulator
from sim.lacing import LOOP
from tests.sim_designs import around, cloth, held, laced, linear_muscle, middle

SIMULATOR = Simulator()
G, L = 9.81, 0.2


def shape(design, kpa=(), **factors):
    return middle(SIMULATOR.equilibria([held(design, kpa, **factors)])[0])


def share(simulated, expected):
    return float(np.max(np.abs(np.asarray(simulated) / expected - 1)))


def test_sag(record):
    # u(L) = rho g L^2 / 2 k
    sag = -L - shape(cloth(poisson=0.0))[-1, :, 1]
    miss = share(sag, 0.6 * G * L**2 / (2 * 520))
    record("hanging sheet, sag", "2 %", f"{miss:.2%}")
    assert miss < 0.02


def test_strip(record):
    # e_2 = T / k, e_1 = -nu e_2, far from the held edge
    width, tension = 0.05, 26.0
    bar = linear_muscle(1e-3, 0.0, name="bar", mass_per_length=tension / G, axis_offset=0.0)
    weight = Muscle("bar", "front", 0, ((0.0, L), (width, L)), width)
    points = shape(cloth(weight, types={"bar": bar}, width=width, areal_density=1e-3), (0,))
    stretch = (points[15, 20, 1] - points[25, 20, 1]) / (10 * L / 40) - 1
    narrow = (points[20, -1, 0] - points[20, 0, 0]) / width - 1
    miss = share(stretch, tension / 520), share(narrow, -0.25 * tension / 520)
    record("strip, traction", "1 %", f"{miss[0]:.2%}")
    record("strip, lateral contraction", "5 %", f"{miss[1]:.2%}")
    assert miss[0] < 0.01 and miss[1] < 0.05


def test_sheet_pushed_at_45_degrees(record):
    # uniform tension s along 45 degrees: 1 / k_45 = (1/k_1 + 1/k_2 - 2 nu_12 / k_1 + 1/S) / 4.
    # Equal struts along the diagonals, F each, sqrt(2) spacing apart, make s = F sqrt(2) / spacing.
    spacing, push = 0.01, 0.01
    rows = [(p, e) for p in (0.0, 1e5) for e in (-0.1, 0.0, 0.1, 0.2)]
    table = BenchTable(*zip(*[(p, e, -push + 1e-8 * p / 1e5 - 1e-5 * e) for p, e in rows], strict=True))
    law = MuscleLaw.fit(table)
    force = -float(law.tension(0.0, 0.0))
    struts = []
    for k in range(1, 40):
        c = k * spacing  # the line u + v = c
        ends = ((min(c, L), max(c - L, 0.0)), (max(c - L, 0.0), min(c, L)))
        struts.append(Muscle("strut", "front", 0, ends, 1.0))
    types = {"strut": MuscleType("strut", 0.002, 0.0, 0.0, table)}
    nothing = {"gravity": (0.0, 0.0, 0.0), "hung": "none"}
    points = shape(cloth(*struts, types=types, **nothing), (0,))
    diagonal = np.linalg.norm(points[10, 30] - points[30, 10]) / (0.1 * np.sqrt(2)) - 1
    compliance = (1 / 520 + 1 / 520 - 2 * 0.25 / 520 + 1 / 130) / 4
    expected = force * np.sqrt(2) / spacing * compliance
    miss = share(diagonal, expected)
    record("sheet stretched at 45 degrees", "3 %", f"{miss:.2%}")
    assert miss < 0.03


def test_cantilever(record):
    # z(L) = w L^4 / 8 B
    w = 0.1
    points = shape(cloth(poisson=0.0, areal_density=w / G, gravity=(0.0, 0.0, -G), support="clamped"))
    miss = share(-points[-1, :, 2], w * L**4 / (8 * 0.006))
    record("cantilever, tip", "3 %", f"{miss:.2%}")
    assert miss < 0.03


def test_fixed_fixed(record):
    # z(L/2) = w L^4 / 384 B; two held rows at each end clamp it half a spacing inside the second
    w, h = 0.5, L / 40
    rows = tuple((u, v) for v in (0.0, h, L - h, L) for u in np.linspace(0, L, 41))
    points = shape(cloth(poisson=0.0, areal_density=w / G, gravity=(0.0, 0.0, -G), hung=rows))
    miss = share(-points[20, :, 2], w * (L - h) ** 4 / (384 * 0.006))
    record("fixed-fixed, middle", "3 %", f"{miss:.2%}")
    assert miss < 0.03


def test_heavy_elastica(record):
    # B theta'' = -w (L - s) cos(theta), theta(0) = 0, theta'(L) = 0; theta below the horizontal
    w, b = 0.6 * G, 0.006
    s = np.linspace(0, L, 400)
    solved = solve_bvp(
        lambda s, y: np.array([y[1], -w * (L - s) * np.cos(y[0]) / b]),
        lambda a, z: np.array([a[0], z[1]]),
        s,
        np.array([np.pi / 2 * np.sin(s / L * np.pi / 2), 0 * s]),
        tol=1e-8,
    )
    theta = solved.sol(s)[0]
    along, down = np.trapezoid(np.cos(theta), s), np.trapezoid(np.sin(theta), s)
    # the clamp holds the plane z = 0 with v down: gravity along z
    points = shape(cloth(poisson=0.0, gravity=(0.0, 0.0, -G), support="clamped", membrane_stiffness=(5200.0, 5200.0)))
    tip = points[-1].mean(0)
    miss = float(np.hypot(-tip[1] - along, abs(tip[2]) - abs(down)) / L)
    record("heavy elastica, tip over length", "2.5 %", f"{miss:.2%}")
    assert solved.success and miss < 0.025


def test_isometric_force(record):
    # both ends held, in the mid-surface lest the cloth's slope there moves them: F = F(p, 0)
    ends = ((0.1, 0.05), (0.1, 0.15))
    kind = replace(laced().muscle_types["EM20"], axis_offset=0.0)
    design = cloth(
        Muscle("EM20", "front", 0, ends, 0.1), types={"EM20": kind}, hung=around(ends, 0.005), gravity=(0.0, 0.0, 0.0)
    )
    pressures = (50.0, 100.0, 200.0, 300.0, 400.0)
    motions = SIMULATOR.run([held(design, (p,)) for p in pressures], [np.array([0.3])] * 5)
    expected = MuscleLaw.fit(kind.bench).tension(1e3 * np.array(pressures), 0.0)
    miss = share([m.tension[-1, 0] for m in motions], expected)
    record("isometric force, 50-400 kPa", "1 %", f"{miss:.2%}")
    assert miss < 0.01


@pytest.mark.parametrize("load", [0.0, 0.5, 1.0, 3.0])
def test_contraction_under_load(load, record):
    # A narrow soft strip between two held edges, a muscle in its upper half and one of constant force in its lower:
    # F(p, eps) - k W eps = load + k W eps; the cloth changes eps by 0.06 points at most
    width, k = 0.05, 5.0
    kind = replace(laced().muscle_types["EM20"], axis_offset=0.0, mass_per_length=0.0)
    rope = linear_muscle(1e-3, load, name="rope", axis_offset=0.0)
    pull = Muscle("EM20", "front", 0, ((width / 2, 0.0), (width / 2, L / 2)), 0.02)
    weight = Muscle("rope", "front", 1, ((width / 2, L / 2), (width / 2, L)), 0.02)
    design = cloth(
        pull, weight, types={"EM20": kind, "rope": rope}, width=width, poisson=0.0, membrane_stiffness=(50.0, k),
        shear_stiffness=50.0, gravity=(0.0, 0.0, 0.0),
        hung=tuple((u, v) for v in (0, L) for u in np.linspace(0, width, 41)),
    )  # fmt: skip
    law, pressures = MuscleLaw.fit(kind.bench), (50.0, 100.0, 200.0, 300.0, 400.0)
    expected = [
        brentq(lambda e, p=kpa: float(law.tension(1e3 * p, e)) - 2 * k * width * e - load, -0.2, 0.4)
        for kpa in pressures
    ]
    cases = [held(design, (kpa, 100.0)) for kpa in pressures]
    shapes = [middle(shape) for shape in SIMULATOR.equilibria(cases)]
    contraction = [1 - np.linalg.norm(x[14, 20] - x[6, 20]) / (8 * L / 40) for x in shapes]
    worst = np.abs(np.subtract(contraction, expected)).max()  # NaN stays
    record(f"contraction under {load:g} N, 50-400 kPa", "0.3 points", f"{100 * worst:.2f} points")
    assert worst < 0.003


def test_one_sided_strip(record):
    # Minimum of equations 2, 5, 8, 10 for uniform stretch e and curvature kappa (the turning per rest length), nu = 0,
    # n muscles of offset d that are straight over the pitch p: k W e + B W kappa^2 (1 + e) = n F deps/de,
    # B W kappa (1 + e)^2 = n F deps/dkappa, eps = 1 - r 2 sin(kappa p / 2) / p with r = (1 + e) c / kappa - d, where
    # c = sinc(kappa LOOP / 2)^4 is the loop's mean over an arc; front = back cancels the moment
    width, count, pitch, step = 0.05, 4, 0.02, 1e-6
    kind = laced().muscle_types["EM20"]
    us = (np.arange(count) + 0.5) * width / count
    law = MuscleLaw.fit(kind.bench)

    def strip(sides):
        muscles = [Muscle("EM20", s, c, ((u, 0.0), (u, L)), pitch) for c, s in enumerate(sides) for u in us]
        return cloth(
            *muscles, types={"EM20": kind}, width=width, poisson=0.0, bending_stiffness=(0.06, 0.006), hung="none",
            gravity=(0.0, 0.0, 0.0),
        )  # fmt: skip

    def contraction(e, kappa):
        radius = (1 + e) * np.sinc(kappa * LOOP / 2 / np.pi) ** 4 / kappa - kind.axis_offset
        return 1 - radius * 2 * np.sin(kappa * pitch / 2) / pitch

    misses = []
    for kpa in (100.0, 200.0, 300.0):

        def balance(y, p=1e3 * kpa):
            e, kappa = y
            by_e = (contraction(e + step, kappa) - contraction(e - step, kappa)) / (2 * step)
            by_kappa = (contraction(e, kappa + step) - contraction(e, kappa - step)) / (2 * step)
            force = count * float(law.tension(p, contraction(e, kappa)))
            bent = 0.006 * width * kappa * (1 + e)
            return [520 * width * e + bent * kappa - force * by_e, bent * (1 + e) - force * by_kappa]

        _, curvature = fsolve(balance, [-0.02, 1.0])
        line = shape(strip(["front"]), (kpa,))[10:31, 20]
        tangent = np.unwrap(np.arctan2(*np.diff(line[:, [2, 1]], axis=0).T))
        simulated = abs(tangent[-1] - tangent[0]) / (19 * L / 40)
        misses.append(share(simulated, abs(curvature)))
    worst = np.max(misses)  # NaN stays
    record("one-sided strip, curvature", "5 %", f"{worst:.2%}")
    both = shape(strip(["front", "back"]), (100.0, 100.0))
    shortened = brentq(lambda e: 520 * width * e + 2 * count * float(law.tension(1e5, -e)), -0.3, 0.1)
    length = np.linalg.norm(both[10, 20] - both[30, 20]) / (L / 2) - 1
    normal = np.cross(both[20, 40] - both[20, 0], both[30, 20] - both[10, 20])
    bow = abs((both[20, 20] - (both[10, 20] + both[30, 20]) / 2) @ normal) / np.linalg.norm(normal)
    record("front and back alike: bow; shortening", "5 %", f"{bow * 1e6:.2f} um; {share(length, shortened):.2%}")
    assert worst < 0.05 and bow < 1e-5 and share(length, shortened) < 0.05
