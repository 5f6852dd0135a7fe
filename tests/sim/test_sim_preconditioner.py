"""Fixed points on the modes across, beside the same with weights of nodes: Green's functions and the muscles' part."""

import numpy as np
import pytest
import taichi as ti

from sim import Simulator
from sim.kernels.fields import LANES, SPREAD, F, X
from sim.lacing import lace, touched
from sim.solver.muscles import solve
from sim.state import GREEN
from tests.sim_designs import held, laced

N = 21
KINDS = ((0, 1), (4, 1), (0, 5), (2, 1), (0, 3))  # weights across and down of the functionals of a normal component


@ti.kernel
def _solve(n: ti.i32, points: ti.i32):
    for task in range(SPREAD):
        if task == 0:
            solve(0, n, n, points, False)


def inverse(right, points):
    """P^-1 of (N N, 3) for all lanes alike; the cloth's alone with points = 0."""
    values = np.zeros((*F.modal3.shape, 3 * LANES), np.float32)
    values[0, : N * N] = np.repeat(right, LANES, axis=1)
    F.modal3.from_numpy(values)
    _solve(N, points)
    return F.modal3.to_numpy()[0, : N * N].astype(float).reshape(N * N, 3, LANES)[:, :, 0]


@pytest.fixture(scope="module", params=["basic", "cross", "side"])
def stepped(request):
    """(points, 5, N N): what the functionals are in weights of nodes; fields as the last step of a motion left them."""
    design = laced() if request.param == "basic" else laced(request.param, 2)
    Simulator(points_per_side=N).run([held(design, (200,) * design.channels)], [np.array([0.02])])
    lacing = lace(design, N, *touched(design, N))
    weights = np.zeros((len(lacing.offset), 5, N, N))
    for p, (row, column) in enumerate(lacing.base):
        for f, (across, down) in enumerate(KINDS):
            patch = np.outer(lacing.weights[down, p], lacing.weights[across, p])
            rows, columns = min(len(patch), N - row), min(len(patch), N - column)
            weights[p, f, row : row + rows, column : column + columns] = patch[:rows, :columns]
    return weights.reshape(len(weights), 5, N * N)


def test_greens_functions_are_those_of_nodal_forces(stepped):
    green = F.green.to_numpy()[0, ..., 0].reshape(F.points, F.points, GREEN)
    for b in (0, 1, len(stepped) // 2, len(stepped) - 1):
        for f in range(5):
            response = inverse(np.repeat(stepped[b, f][:, None], 3, axis=1), 0)
            expected = stepped @ response[:, 2]
            assert green[: len(stepped), b, 2 + f :: 5] == pytest.approx(expected, abs=2e-5 * np.abs(expected).max())
            if f == 0:
                expected = stepped[:, 0] @ response[:, :2]
                assert green[: len(stepped), b, :2] == pytest.approx(expected, abs=2e-5 * np.abs(expected).max())


def test_muscles_answer_what_they_are_stretched_by(stepped):
    # P = K0 + J^T J / compliance: y = K0^-1 (r - J^T (J y) / compliance)
    count = len(stepped)
    right = np.random.default_rng(1).standard_normal((N * N, 3)) * 1e-3
    right[:N] = 0
    y = inverse(right, count)
    point = F.point.to_numpy()[0, ..., 0]
    coefficient = point[X.coef : X.coef + 14 * F.points].reshape(2, 7, F.points)[:, :, : count - 1].astype(float)
    compliance = point[X.compliance : X.compliance + count - 1].astype(float)
    jacobian = np.zeros((count - 1, N * N, 3))
    for end in range(2):
        functionals = stepped[end : end + count - 1]
        jacobian[:, :, :2] += coefficient[end, :2].T[:, None] * functionals[:, 0, :, None]
        jacobian[:, :, 2] += np.einsum("fk,kfn->kn", coefficient[end, 2:], functionals)
    tension = np.einsum("knc,nc->k", jacobian, y) / compliance
    answer = np.einsum("knc,k->nc", jacobian, tension)
    answer[:N] = 0  # the edge is held
    expected = inverse(right - answer, 0)
    assert np.abs(answer).max() > 0.1 * np.abs(right).max()
    assert y == pytest.approx(expected, abs=0.003 * np.abs(expected).max())
