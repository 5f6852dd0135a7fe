"""The solver's two dominant loops, forces of the cloth and the flat cloth's own solve, by Taichi beside the same loops
in C with vector intrinsics (kernel.c, kernel_solve.h). One block of 8 designs, one core."""

import ctypes
import shutil
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from benchmarks.sim.cases import reference
from sim.chunks import BLOCKS
from sim.forces.cloth import fabric_force
from sim.grid import Support
from sim.kernels import fields
from sim.kernels.fields import SPREAD, F, Timed
from sim.loading import load
from sim.materials import M
from sim.solver.flat_cloth import factorise
from sim.solver.muscles import solve
from sim.time_steps import Integrator, Scheme

Array = NDArray[np.float32]
SCHEME = Scheme(1 / 480, Integrator.GENERALISED_ALPHA)
FREE = int(Support.NONE)
PROCESSOR = Path("/proc/cpuinfo")
REPEATS = 50  # evaluations in one call
PLANES3 = ("q", "x0", "v", "hv", "ha", "f", "carried", "tu", "tv", "n", "na", "nb", "ca", "cb", "cd", "pu", "pv")
PLANES = ("eu", "ev", "su", "sv", "s1", "s2", "mass")
CONSTANTS = (
    "IHU", "IHV", "K1", "K2", "K12", "S", "D1", "D2", "D12", "B1", "B2", "T", "VISCOSITY", "AIR", "GX", "AREA",
    "TOP_HELD", "BOTTOM_HELD", "Q1", "R1", "Q2", "R2",
)  # fmt: skip


@ti.kernel
def _forces_kernel(nu: ti.i32, nv: ti.i32, repeats: ti.i32):
    for task in range(SPREAD):  # as the solver's own loop over blocks: the first iteration is all there is
        if task == 0:
            for _ in range(repeats):
                fabric_force(0, nu, nv, FREE, False)


@ti.kernel
def _solve_kernel(nu: ti.i32, nv: ti.i32, repeats: ti.i32):
    for task in range(SPREAD):
        if task == 0:
            for _ in range(repeats):
                k = 0
                while k < nu * nv:
                    F.modal3[0, k] = F.modal3[0, 2 * nu * nv + k]
                    k = F.after[k]
                solve(0, nu, nv, 0, False)


@ti.kernel
def _factor_kernel(nu: ti.i32, nv: ti.i32):
    for task in range(SPREAD):
        if task == 0:
            factorise(0, nu, nv)


_forces, _solve, _factor = Timed(_forces_kernel), Timed(_solve_kernel), Timed(_factor_kernel)


def missing() -> str | None:
    """Why the comparison cannot be made here."""
    if shutil.which("gcc") is None:
        return "no gcc"
    if fields.LANES != 8:
        return f"lanes of {fields.LANES}; kernel.c is for 8"
    if not PROCESSOR.exists() or "avx2" not in PROCESSOR.read_text().split():
        return "no AVX2"
    return None


class ByTaichi:
    """The kernels on 8 designs with n x n nodes: stretched; displacements, velocities and a right side at random."""

    def __init__(self, n: int) -> None:
        self.n = n
        [case] = reference(1)
        bare = replace(case, design=replace(case.design, muscle_types={}, muscles=()))  # no bench table to fit
        load([bare] * fields.LANES, n, support=Support.TOP, blocks=BLOCKS)
        scheme = F.scheme.to_numpy()
        scheme[0] = np.array(SCHEME.entries(Support.NONE))[:, None]
        F.scheme.from_numpy(scheme)
        _factor(n, n)
        rng = np.random.default_rng(7)
        inside = ((np.arange(n)[:, None] + 1) * (n + 2) + np.arange(n) + 1).ravel()
        state = F.node3.to_numpy()
        state[0, F.q + inside] *= 1.02
        state[0, F.x0 + inside] = state[0, F.q + inside]
        for plane, size in ((F.q, 1e-4), (F.hv, 0.5), (F.ha, 1.0), (F.carried, 1e-4)):  # m, m/s, m/s^2, N
            state[0, plane + inside] += size * rng.standard_normal((n * n, 3 * fields.LANES)).astype(np.float32)
        F.node3.from_numpy(state)
        right = F.modal3.to_numpy()
        right[0, 2 * n * n : 3 * n * n] = rng.standard_normal((n * n, 3 * fields.LANES))
        F.modal3.from_numpy(right)

    def forces(self, repeats: int) -> None:
        _forces(self.n, self.n, repeats)
        ti.sync()

    def solve(self, repeats: int) -> None:
        _solve(self.n, self.n, repeats)
        ti.sync()

    def results(self) -> tuple[Array, Array]:
        """Forces, solution; ghosts included."""
        return _results(F.node3.to_numpy()[0], F.modal3.to_numpy()[0], self.n)


class ByHand:
    """kernel.c, compiled, with a copy of what lies in the first block."""

    def __init__(self, n: int) -> None:
        self.library, self.n = _compile(), n
        self.node3, self.node, self.lane, self.modal, self.factors = (
            _aligned(field.to_numpy()[0]) for field in (F.node3, F.node, F.lane, F.modal3, F.bands3)
        )
        self.basis, self.odd = _aligned(F.basis.to_numpy()), F.odd[None]

    def forces(self, repeats: int) -> None:
        grid = ctypes.c_int(self.n), ctypes.c_int(self.n)
        scheme = ctypes.c_float(SCHEME.ca), ctypes.c_float(SCHEME.cv)
        self.library.forces(*map(_address, (self.node3, self.node, self.lane)), *grid, *scheme, ctypes.c_int(repeats))

    def solve(self, repeats: int) -> None:
        sizes = [ctypes.c_int(k) for k in (self.n, self.n, self.odd, repeats)]
        self.library.solve(*map(_address, (self.modal, self.factors, self.basis, self.lane)), *sizes)

    def results(self) -> tuple[Array, Array]:
        return _results(self.node3, self.modal, self.n)


def _results(node3: Array, modal: Array, n: int) -> tuple[Array, Array]:
    return node3[F.f : F.f + (n + 2) ** 2], modal[: n * n]


def disagreement(n: int) -> tuple[float, float]:
    """Largest difference of a force between both over the largest force, and the same of the solution."""
    pair = ByTaichi(n), ByHand(n)
    for one in pair:
        one.forces(1)
        one.solve(1)
    forces, solution = (
        float(np.abs(a - b).max() / np.abs(b).max())
        for a, b in zip(*(one.results() for one in pair), strict=True)
    )  # fmt: skip
    return forces, solution


def seconds(n: int, rounds: int) -> NDArray[np.float64]:
    """(rounds, 2 loops, 2) s of one evaluation of 8 designs: forces and solve, by Taichi and by hand; in turn, so that
    all meet the same machine."""
    pair = ByTaichi(n), ByHand(n)
    runs = [[one.forces for one in pair], [one.solve for one in pair]]
    taken = np.empty((rounds + 1, 2, 2))
    for k in range(rounds + 1):  # the first round warms up
        for loop in range(2):
            for who in range(2):
                begin = time.perf_counter()
                runs[loop][who](REPEATS)
                taken[k, loop, who] = (time.perf_counter() - begin) / REPEATS
    return taken[1:]


def _compile() -> Any:
    names = {f"P_{name.upper()}": getattr(F, name) for name in (*PLANES3, *PLANES)}
    names |= {f"L_{name}": getattr(M, name) for name in CONSTANTS}
    options = ["-O3", "-march=native", "-ffast-math", "-fPIC", *(f"-D{k}={v}" for k, v in names.items())]
    with tempfile.TemporaryDirectory() as folder:
        compiled, made = Path(folder) / "kernel.o", Path(folder) / "kernel.so"
        source = Path(__file__).with_name("kernel.c")
        subprocess.run(["gcc", *options, "-c", str(source), "-o", str(compiled)], check=True)
        # linked without -ffast-math, which would flush subnormal numbers to zero in all of the process
        subprocess.run(["gcc", "-shared", str(compiled), "-o", str(made)], check=True)
        return ctypes.CDLL(str(made))


def _address(values: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)


def _aligned(values: Array) -> Array:
    """A copy that begins at a multiple of 64 bytes."""
    room = np.empty(values.nbytes + 64, np.uint8)
    begin = -room.ctypes.data % 64
    copy = room[begin : begin + values.nbytes].view(np.float32).reshape(values.shape)
    copy[:] = values
    return copy
