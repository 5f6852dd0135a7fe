"""Contact of the cloth with itself: its energy's gradient, which pairs there are, a landing, a weight, bits."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti

from sim import Simulator
from sim.chunks import Chunk, laid
from sim.forces.contact import STIFFNESS, ContactSheet, contact, find, no_pairs, put
from sim.kernels import fields
from sim.kernels.fields import LANES, F
from tests.layers import depth
from tests.sim.sim_reference import ReferenceSheet
from tests.sim_designs import cloth, held, laced, rolled
from tests.thrown import thrown

N, L, T, G = 21, 0.2, 0.002, 9.81
SIMULATOR = Simulator(points_per_side=N, self_contact=True)
NOWHERE = {"hung": "none", "gravity": (0.0, 0.0, 0.0)}


@ti.kernel
def forces(row: ti.i32):
    contact(0, row)


def test_forces_are_the_gradient_of_the_energy():
    # W = k (t - s n . (x - y))^2 / 2, n of the cell's mean edges; central differences in double precision
    n, xi, eta, k = 9, 0.3, 0.8, 700.0
    node, cell = (7, 2), (3, 4)
    rng = np.random.default_rng(1)
    with fields.lock:
        laid(Chunk([0], [held(cloth())], [0] * LANES), n, False)
        x = ReferenceSheet(cloth(), n).rest.reshape(n, n, 3) + rng.normal(0, 2e-3, (n, n, 3))
        x[node] = x[3:5, 4:6].mean((0, 1)) + (0.002, -0.003, -0.0012)
        x = x.astype(np.float32).astype(float)
        state = F.node3.to_numpy()
        plane = np.zeros((n + 2, n + 2, 3))
        plane[1:-1, 1:-1] = x
        state[0, F.q : F.q + (n + 2) ** 2] = np.repeat(plane.reshape(-1, 3), LANES, axis=1)
        state[0, F.f : F.f + (n + 2) ** 2] = 0
        F.node3.from_numpy(state)
        padded = [(r + 1) * (n + 2) + c + 1 for r, c in (node, cell)]
        values = np.array([xi, eta, -1.0, T, k], np.float32)
        put(
            1,
            np.repeat(np.array(padded, np.int32)[None, :, None, None], LANES, axis=-1),
            np.repeat(values[None, :, None, None], LANES, axis=-1),
        )
        forces(n)
        force = F.node3.to_numpy()[0, F.f : F.f + (n + 2) ** 2].reshape(n + 2, n + 2, 3, LANES)[1:-1, 1:-1, :, 0]
        F.pairs[0] = 0

    def energy(x):
        a, b, c, d = x[3, 4], x[3, 5], x[4, 4], x[4, 5]
        normal = np.cross(c + d - a - b, b + d - a - c)
        foot = (1 - xi) * (1 - eta) * a + xi * (1 - eta) * b + (1 - xi) * eta * c + xi * eta * d
        return k * max(0.0, T + normal @ (x[node] - foot) / np.linalg.norm(normal)) ** 2 / 2

    expected = np.zeros_like(x)
    for index in np.ndindex(x.shape):
        step = np.zeros_like(x)
        step[index] = 1e-7
        expected[index] = (energy(x - step) - energy(x + step)) / 2e-7
    largest = np.abs(expected).max()
    assert largest > 0.1 and np.abs(force - expected).max() < 1e-4 * largest
    assert np.abs(force.sum((0, 1))).max() < 1e-5 * largest
    assert np.abs(np.cross(x, force).sum((0, 1))).max() < 1e-5 * largest * L


def hairpin(gap, n=N):
    """(n, n, 3) m: two leaves `gap` apart, the front inside, and half a circle of rows between them."""
    s = np.linspace(0, L, n) - L / 2
    radius = gap / 2
    bend = np.clip(s / radius, -np.pi / 2, np.pi / 2)
    along = np.abs(s - radius * bend) - radius * np.cos(bend)
    x = np.empty((n, n, 3))
    x[..., 0] = np.linspace(-L / 2, L / 2, n)
    x[..., 1], x[..., 2] = -along[:, None], -radius * np.sin(bend)[:, None]
    return x


def sheet(n=N):
    return ContactSheet.of(held(cloth()), n)


def test_pairs_are_those_of_the_other_leaf():
    x = hairpin(0.012)
    none = no_pairs(N * N)
    assert not find(hairpin(0.03), sheet(), 0.014, none)["side"].any()
    pairs = find(x, sheet(), 0.014, none)
    node, layer = np.nonzero(pairs["side"])
    rows = node // N
    assert set(range(7)) | set(range(14, 21)) <= set(rows.tolist())  # all of both leaves
    other = pairs["row"][node, layer] + pairs["eta"][node, layer]
    leaf = np.abs(rows - 10) > 3
    assert np.abs(other + rows - 20)[leaf].max() < 0.2  # opposite
    assert (pairs["side"][node, layer] == pairs["side"][0, 0]).all() and (layer == 0).all()


def test_node_that_has_slipped_through_keeps_its_side():
    x = hairpin(0.012)
    before = find(x, sheet(), 0.014, no_pairs(N * N))
    x[0, 10, 2] -= 0.0121  # through the other leaf by 0.1 mm
    kept, fresh = find(x, sheet(), 0.014, before), find(x, sheet(), 0.014, no_pairs(N * N))
    node = 10
    assert kept["side"][node, 0] == before["side"][node, 0] == -fresh["side"][node, 0] != 0


def test_leaf_lands_on_the_other_and_momentum_stays():
    # an undamped free sheet, folded, one leaf thrown at the other at 1 m/s
    design = cloth(bending_stiffness=(1e-5, 1e-5), viscosity=0.0, air_damping=0.0, **NOWHERE)
    times, start = np.arange(1, 49) / 960, hairpin(0.02)
    velocity = np.zeros((N, N, 3))
    velocity[:9, :, 2] = -1.0 * np.linspace(1, 0, 9)[:, None]
    through, frames = (thrown(s, design, velocity, times, positions=start) for s in (
        replace(SIMULATOR, self_contact=False, calm_steps=2), replace(SIMULATOR, calm_steps=2)
    ))  # fmt: skip
    assert max(depth(x, design) for x in through) > 0.5
    deepest = max(depth(x, design) for x in frames)
    assert 0 < deepest < 0.5
    mass = ReferenceSheet(design, N).mass[:, None]
    x = frames.reshape(len(times), -1, 3)
    v = (x[2:] - x[:-2]) / (times[2] - times[0])
    scale = (mass * np.abs(velocity.reshape(-1, 3))).sum()
    assert np.abs((mass * v).sum(1) - (mass * velocity.reshape(-1, 3)).sum(0)).max() < 2e-3 * scale
    spin = (mass * np.cross(start.reshape(-1, 3), velocity.reshape(-1, 3))).sum(0)
    assert np.abs((mass * np.cross(x[1:-1], v)).sum(1) - spin).max() < 2e-3 * scale * L


def test_leaf_rests_on_the_other_by_its_weight():
    # both leaves' nodes press: depth = weight per area / 2 k; far from the fold and the border
    lying = tuple((u, v) for v in np.linspace(0, L, N)[11:] for u in np.linspace(0, L, N))
    design = cloth(
        bending_stiffness=(1e-5, 1e-5), areal_density=30.0, air_damping=2000.0, hung=lying, gravity=(0.0, 0.0, -G)
    )
    frames = thrown(replace(SIMULATOR, calm_steps=4), design, None, np.array([0.5, 1.0]), positions=hairpin(0.012))
    gap = (frames[:, 2:6] - frames[:, 18:14:-1])[:, :, 5:-5, 2]
    assert np.abs(gap[1] - gap[0]).max() < 1e-5
    expected = 30.0 * G / (2 * STIFFNESS * 520 / T**2)
    assert T - gap[1].mean() == pytest.approx(expected, rel=0.03)


def test_rolled_up_cloth_keeps_its_layers_apart_alone_and_among_others():
    # on a coarse grid; the finer one is in tests/verify
    simulator, times = replace(SIMULATOR, calm_steps=1), np.linspace(0.45, 0.6, 10)
    cases = [rolled(height=0.25), rolled(), rolled(bending=6e-3)]
    motion = simulator.run(cases, [times] * 3)[1]
    assert motion.diverged is None
    deepest = max(depth(x, cases[1].design) for x in motion.middle.astype(float))
    assert 0 < deepest < 0.5
    assert np.array_equal(simulator.run([cases[1]], [times])[0].middle, motion.middle)
    off = replace(simulator, self_contact=False).run([cases[1]], [times])[0]
    assert max(depth(x, cases[1].design) for x in off.middle.astype(float)) > 0.5


def test_cloth_that_does_not_touch_moves_as_without_contact():
    case, times = held(laced(), (200, 100, 0, 50)), np.array([0.05, 0.2])
    on, off = (s.run([case], [times])[0] for s in (SIMULATOR, replace(SIMULATOR, self_contact=False, calm_steps=1)))
    assert np.array_equal(on.middle, off.middle)
