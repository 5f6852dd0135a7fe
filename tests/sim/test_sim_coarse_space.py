"""The preconditioner's coarse space: beside float64 matrices of the same shape, and what it adds to a solve."""

import numpy as np
import pytest
import scipy.linalg
import taichi as ti

from sim import Simulator
from sim.grid import Support
from sim.kernels.fields import LANES, SPREAD, C, F
from sim.solver.coarse_solve import factorise
from sim.solver.coarse_space import bent, copy, flat, pull
from sim.solver.modes import modes_across, modes_down
from sim.solver.muscles import solve
from sim.state import COARSE, COARSE_ACROSS, COARSE_DOWN
from sim.time_steps import Integrator, Scheme
from tests.sim.sim_reference import ReferenceSheet
from tests.sim_designs import held, laced

N = 21
SCHEME = Scheme(1 / 120, Integrator.GENERALISED_ALPHA)  # of the last step below, whose muscles are in the matrices


@ti.kernel
def _matrices(points: ti.i32):
    for task in range(SPREAD):
        if task == 0:
            flat(0)
            pull(0, points)
            copy(0)
            bent(0, N, N)


@ti.kernel
def _factor():
    for task in range(SPREAD):
        if task == 0:
            factorise(0, C.coupled)
            factorise(0, C.alone)


@ti.kernel
def _solve(points: ti.i32, coarse: ti.i32):
    for task in range(SPREAD):
        if task == 0:
            solve(0, N, N, points, coarse)


def matrix(start: int) -> np.ndarray:
    upper = np.triu(F.coarse.to_numpy()[0, start : start + COARSE**2, 0].astype(float).reshape(COARSE, COARSE))
    return upper + np.triu(upper, 1).T


def modes() -> np.ndarray:
    """(N N, 3, COARSE): components u, v and normal."""
    across, (down, _) = modes_across(N, Support.TOP), modes_down(N, Support.TOP)
    soft = np.argsort(across.stretching, kind="stable")[:COARSE_ACROSS]
    count = COARSE_ACROSS * COARSE_DOWN
    w = np.zeros((N * N, 3, COARSE))
    for c, basis in enumerate((across.tangential, across.tangential, across.normal)):
        products = np.einsum("jm,ik->jikm", down[:, :COARSE_DOWN], basis[:, soft])
        w[:, c, c * count : (c + 1) * count] = products.reshape(N * N, count)
    return w


@pytest.fixture(scope="module", params=["basic", "cross"])
def bent_sheet(request):
    """(design, points, E, E_P) after 0.3 s under pressure; fields as the last step left them."""
    design = laced() if request.param == "basic" else laced("cross", 2)
    simulator = Simulator(points_per_side=N, calm_steps=16)
    simulator.run([held(design, (200, 100, 50, 150)[: design.channels])], [np.array([0.3])])
    points = sum(len(muscle.fixed_points()) for muscle in design.muscles)
    _matrices(points)
    return design, points, matrix(C.coupled), matrix(C.alone)


def test_coupled_matrix_is_that_of_the_reference(bent_sheet):
    # E against W^T A W with A = K + M ca of the float64 model in the same shape: its stretching and bending modes
    design, _, coupled, _ = bent_sheet
    node3 = F.node3.to_numpy()[0]

    def plane(first):
        inside = node3[first : first + (N + 2) ** 2].reshape(N + 2, N + 2, 3, LANES)[1:-1, 1:-1, :, 0]
        return inside.reshape(-1, 3).astype(float)

    reference = ReferenceSheet(design, N)
    q, u, n = plane(F.q), plane(F.fu), plane(F.fn)
    axes = np.stack([u, np.cross(u, n), n], axis=1)  # (nodes, component, xyz)
    w = np.einsum("ncx,ncm->nxm", axes, modes()).reshape(3 * N * N, COARSE)
    pressure = 1e3 * np.array((200, 100, 50, 150)[: design.channels])
    _, stiffness = reference.evaluate(q, np.zeros_like(q), pressure, SCHEME.cv)
    exact = w.T @ (stiffness @ w) + w.T @ (np.repeat(reference.mass * SCHEME.ca, 3)[:, None] * w)
    ratio = scipy.linalg.eigh(coupled, exact, eigvals_only=True)
    assert ratio[0] > 0.5 and ratio[-1] < 1.7


def test_flat_matrix_is_far_from_it(bent_sheet):
    # what it is there for: a sheet that bends without stretching seems many times too stiff without it
    _, _, coupled, alone = bent_sheet
    assert scipy.linalg.eigh(coupled, alone, eigvals_only=True)[0] < 0.25


def test_solve_adds_what_the_matrices_say(bent_sheet):
    # y += W (E^-1 - E_P^-1) W^T r
    _, points, coupled, alone = bent_sheet
    w = modes()
    right = np.random.default_rng(1).standard_normal((N * N, 3)) * 1e-3
    right[:N] = 0
    _factor()
    solutions = []
    for coarse in (1, 0):
        values = np.zeros((*F.modal3.shape, 3 * LANES), np.float32)
        values[0, : N * N] = np.repeat(right, LANES, axis=1)
        F.modal3.from_numpy(values)
        _solve(points, coarse)
        solutions.append(F.modal3.to_numpy()[0, : N * N].astype(float).reshape(N * N, 3, LANES)[:, :, 0])
    s = np.einsum("ncm,nc->m", w, right)
    expected = np.einsum("ncm,m->nc", w, np.linalg.solve(coupled, s) - np.linalg.solve(alone, s))
    assert solutions[0] - solutions[1] == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


def test_normal_modes_are_those_of_a_free_beam():
    # cos x cosh x = 1: x = 4.7300, 7.8532, 10.9956; eigenvalue (x / (n - 1))^4 of nodes a unit apart
    eigenvalues = np.sort(modes_across(161, Support.TOP).bending)
    assert eigenvalues[:2] == pytest.approx([0, 0], abs=1e-12)
    assert eigenvalues[2:5] == pytest.approx((np.array([4.7300, 7.8532, 10.9956]) / 160) ** 4, rel=0.03)


@pytest.mark.parametrize("support", [Support.TOP, Support.LEFT, Support.RIGHT])
@pytest.mark.parametrize("n", [20, 21])
def test_modes_are_orthonormal(n, support):
    across = modes_across(n, support)
    weight = np.ones(n)
    weight[[0, -1]] = 0.5
    free = n if support == Support.TOP else n - 1
    for basis in (across.tangential, across.normal):
        assert (basis.T * weight) @ basis == pytest.approx(np.diag([1.0] * free + [0.0] * (n - free)), abs=1e-9)
    if support == Support.TOP:
        even = n - across.odd
        assert across.normal[::-1, :even] == pytest.approx(across.normal[:, :even], abs=1e-9)
        assert across.normal[::-1, even:] == pytest.approx(-across.normal[:, even:], abs=1e-9)
