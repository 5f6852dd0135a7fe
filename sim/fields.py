"""The one owner of Taichi: starts it, and holds every array that the kernels work on.

Layout (measured, see docs/results/simulator.md): LANES designs ride side by side, innermost, as the entries
of one `Vector.field(LANES)`, so that LLVM emits vector loads and stores; a block of them belongs to one thread.

Node arrays are planes of `F.node`: component c of node (row j, column i) of an nv x nu grid is entry
`F.plane_name + c * P + k`, with P = (nu + 2)(nv + 2), k = (j + 1)(nu + 2) + i + 1: a ring of zero ghosts lies around.
Arrays over fixed points are planes of `F.point`, `X.plane_name + c * F.points + index`. An interval of a muscle has the
index of its first fixed point. Offsets are constants of the compiled kernels; grid size and counts are run-time values.

Inner loops are `while` loops that step by `k = F.after[k]`, which is k + 1: where LLVM foresees the next index, it
spends nine tenths of the compile time on the loop.
"""

import contextlib
import io
import os
import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np

os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
try:
    import taichi as ti
except ImportError as error:  # a bare machine lacks libX11
    from fabdesign.errors import InputError

    raise InputError(f"cannot load taichi ({error}); on Debian: apt install libx11-6") from error

LANES = 8
SPREAD = 512  # iterations of an outer loop that Taichi gives a thread at least: block b is iteration SPREAD b
FUNCTIONALS = 7  # of the warped displacement at a fixed point: u, v, w, (w s_u), (w s_v), w_u, w_v
GREEN = 27  # numbers kept for each pair of fixed points: uu, vv, and 5 x 5 of the normal component
TYPES = 8  # muscle types in one batch
TABLE = (101, 701)  # pressures 0 ... 1000 kPa, contractions -0.25 ... 0.45
PRESSURE_STEP = 10e3  # Pa
FIRST_CONTRACTION, CONTRACTION_STEP = -0.25, 0.001

# per-lane constants, entries of F.lane
(
    HU, HV, IHU, IHV, KH1, KH2, K12, SH, D1, D2, D12, B1, B2, TW, VISC, AIR, GX, GY, GZ, AREA,
    MBAR, DTOP, DBOT, TG, DCLAMP, Q1, R1, Q2, R2,
) = range(29)  # fmt: skip
LANE_CONSTANTS = 32

_NODE = {
    # state: positions, velocities, accelerations, and those of the step before; q and v at the evaluation point
    "x0": 3, "v0": 3, "a0": 3, "xp": 3, "vp": 3, "q": 3, "v": 3, "hv": 3, "ha": 3,
    # residual f; conjugate gradients: residual r, its predecessor rp, preconditioned y, direction p
    "f": 3, "carry": 3, "r": 3, "rp": 3, "y": 3, "p": 3,
    # unit tangents of edges, inverse lengths, strains, tensions; node normals; scratch and forces
    "tu": 3, "tv": 3, "lu": 1, "lv": 1, "eu": 1, "ev": 1, "su": 1, "sv": 1, "n": 3, "i1": 1, "i2": 1, "s1": 1, "s2": 1,
    "na": 3, "nb": 3, "ca": 3, "cb": 3, "cd": 3, "pu": 3, "pv": 3,
    # smooth frames of the preconditioner, lumped mass [kg], 1 where free and 0 where held
    "fu": 3, "fn": 3, "mass": 1, "free": 1,
}  # fmt: skip
_POINT = {
    "wu": 4, "wv": 4, "du": 4, "dv": 4, "eu_w": 4, "ev_w": 4, "offset": 1, "active": 1, "rest": 1, "viscosity": 1,
    "gain": 1, "pos": 3, "tan_u": 3, "tan_v": 3, "normal": 3, "inv_area": 1, "vel": 3, "force": 3, "dir": 3,
    "inv_len": 1, "eps": 1, "rate": 1, "pressure": 1, "tension": 1, "compliance": 1, "lam": 1, "coef": 2 * FUNCTIONALS,
    "resp": FUNCTIONALS, "tmp": 3, "grad_u": 3, "grad_v": 3,
}  # fmt: skip

F: Any = SimpleNamespace(ready=False)
X: Any = SimpleNamespace()
lock = threading.RLock()


def _offsets(planes: dict[str, int], size: int) -> tuple[dict[str, int], int]:
    offsets, total = {}, 0
    for name, width in planes.items():
        offsets[name] = total
        total += width * size
    return offsets, total


def allocate(nodes: int, points: int, modes: int, *, blocks: int) -> None:
    """Start Taichi with room for `blocks` blocks of grids of `nodes` padded nodes (at most `modes` across), `points`
    fixed points and `steps` x channels program entries. Does nothing where there is room already: a second start
    would drop all arrays and compile again."""
    if F.ready and F.nodes >= nodes and F.points >= points and F.modes >= modes:
        return
    grow = (lambda now, then: max(now, then)) if F.ready else (lambda now, then: then)
    nodes, points = grow(getattr(F, "nodes", 0), nodes), grow(getattr(F, "points", 0), points)
    modes = grow(getattr(F, "modes", 0), modes)
    with contextlib.redirect_stdout(io.StringIO()):
        ti.init(arch=ti.cpu, default_fp=ti.f32, offline_cache=True, advanced_optimization=False)
    vector = lambda n: ti.Vector.field(LANES, ti.f32, shape=(blocks, n))  # noqa: E731
    whole = lambda n: ti.Vector.field(LANES, ti.i32, shape=(blocks, n))  # noqa: E731
    node, total = _offsets(_NODE, nodes)
    F.__dict__.update(node, node=vector(total), nodes=nodes, points=points, modes=modes, blocks=blocks)
    point, total = _offsets(_POINT, points)
    X.__dict__.update(point)
    F.point = vector(total)
    F.base, F.start, F.channel, F.kind = whole(points), whole(points), whole(points), whole(points)
    F.lane, F.reduce, F.patch, F.row = vector(LANE_CONSTANTS), vector(16), vector(48), vector(32)
    F.modal, F.factor = vector(9 * nodes), vector(7 * nodes)
    F.basis, F.eigen = ti.field(ti.f32, shape=2 * modes * modes), ti.field(ti.f32, shape=modes)
    F.odd = ti.field(ti.i32, shape=())
    F.green, F.dual = vector(points * points * GREEN), vector(points * points)
    F.table = ti.field(ti.f32, shape=(TYPES, *TABLE))
    F.after = ti.field(ti.i32, shape=9 * nodes)
    F.after.from_numpy(np.arange(1, 9 * nodes + 1, dtype=np.int32))
    F.ready = True


_compile_seconds = [0.0]


def compile_seconds() -> float:
    """Seconds that this process has spent in kernels' first calls (compilation, or loading from the cache)."""
    return _compile_seconds[0]


class Timed:
    """A kernel whose first call after a start of Taichi is booked as compilation."""

    def __init__(self, kernel: Any) -> None:
        self.kernel, self.start = kernel, None

    def __call__(self, *arguments: Any) -> Any:
        if self.start is F.node:
            return self.kernel(*arguments)
        begin = time.perf_counter()
        result = self.kernel(*arguments)
        _compile_seconds[0] += time.perf_counter() - begin
        self.start = F.node
        return result


def upload(field: Any, values: np.ndarray) -> None:
    """Fill the leading entries of a scalar field with `values`."""
    whole = np.zeros(field.shape, np.float32)
    whole[tuple(slice(n) for n in values.shape)] = values
    field.from_numpy(whole)
