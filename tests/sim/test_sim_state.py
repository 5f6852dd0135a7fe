"""What the kernels work on: declared once, loaded by name, and nothing of a batch left for the next one."""

from types import SimpleNamespace

import numpy as np
import pytest
import taichi as ti

from fabdesign.effects.acting import specimen_of
from sim import Simulator, state
from sim.kernels import fields
from sim.kernels.fields import LANES, F, X
from sim.kernels.transfer import ZEROED, ZEROED3, fill
from sim.kernels.vectors import Lanes, Wide
from sim.materials import CONSTANTS, Lane, M, lane_constants
from tests.sim_designs import cloth, held, laced

SIMULATOR = Simulator(points_per_side=21)
SCRATCH = [a for a in state.ARRAYS if a.life == state.SCRATCH and not a.integer]
NUMBERS = (*ZEROED, *(a.name for a in SCRATCH if not a.vector), "lane", "scheme", "across", "down", "coarse_down")
VECTORS = (*ZEROED3, *(a.name for a in SCRATCH if a.vector))


@ti.func
def _fill(b, field: ti.template(), value):
    k = 0
    while k < field.shape[1]:
        field[b, k] = value
        k = F.after[k]  # a loop whose next index LLVM foresees takes ten times as long to compile


@ti.kernel
def _poison(blocks: ti.i32, value: ti.f32):
    for b in range(blocks):
        for name in ti.static(NUMBERS):
            _fill(b, ti.static(getattr(F, name)), Lanes(value))
        for name in ti.static(VECTORS):
            _fill(b, ti.static(getattr(F, name)), Wide(value))


def test_nothing_of_a_batch_is_left_for_the_next_one():
    # whatever lies in the fields, free cloths too, whose state is not brought to rest first
    cases = [held(laced(), (200, 100, 0, 50)), held(laced(hung="none"), (200, 100, 0, 50)), held(cloth(hung="none"))]
    cases.append(held(laced(hung=((0.0, 0.0), (0.2, 0.0))), (0, 0, 50, 0)))
    times = [np.array([0.01, 0.03])] * len(cases)
    before = SIMULATOR.run(cases, times)
    for value in (np.nan, 1e3):
        _poison(F.blocks, value)
        for one, again in zip(before, SIMULATOR.run(cases, times), strict=True):
            assert np.array_equal(one.middle, again.middle) and np.array_equal(one.tension, again.tension)


def test_a_batch_loads_all_that_is_declared_as_loaded():
    with pytest.raises(ValueError, match=r"a batch must load .*'mass'.* and lane; got"):
        fill(1, {"x0": np.zeros((1, 1, 3, LANES))})


def test_no_loop_over_a_field_is_longer_than_the_table_of_steps(monkeypatch):
    """A loop that steps beyond the table reads what lies there, often 0, and never ends. So it was once the planes of
    nodes outgrew those of vectors, in a process that had registered an effect of its own."""
    assert F.after.shape[0] >= max(getattr(F, name).shape[1] for name in (*ZEROED, *ZEROED3))
    monkeypatch.setattr(fields, "F", SimpleNamespace(node3=F.node3, node=SimpleNamespace(shape=(8, 10**6))))
    assert fields.longest_loop() == 10**6


def test_planes_lie_apart():
    SIMULATOR.run([held(laced(), (0,) * 4)], [np.zeros(1)])
    for field, space, places in (("node", F, F.nodes), ("node3", F, F.nodes), ("point", X, F.points)):
        taken = np.zeros(getattr(F, field).shape[1], int)
        for plane in state.planes(field):
            taken[getattr(space, plane.name) :][: plane.entries * places] += 1
        assert (taken == 1).all()


def test_constants_have_names_units_and_values():
    values = lane_constants(Lane(specimen_of(held(laced(support="clamped"), (), bending=2.0, shear=0.5)), 41))
    assert [getattr(M, name) for name in CONSTANTS] == list(range(len(CONSTANTS)))
    assert values[M.HU] == pytest.approx(0.005) and values[M.AREA] == pytest.approx(25e-6)
    assert values[M.S] == 0.5 * 130 and values[M.B1] == 2 * 0.006 and values[M.GY] == -9.81
    assert values[M.CLAMPED] == values[M.TOP_HELD] == 1 and values[M.BOTTOM_HELD] == 0
    # a strip with free sides keeps its declared stiffness: K - K_12^2 / K = k
    assert values[M.K1] - values[M.K12] ** 2 / values[M.K2] == pytest.approx(520)


def test_a_name_is_declared_once():
    with pytest.raises(ValueError, match="plane 'mass' on nodes: there is one of this name already"):
        state.declare(state.Plane("mass", "node", "kg", state.REMEMBERED, "another"))
