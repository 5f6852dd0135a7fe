"""The one owner of Taichi: starts it, and holds every array that the kernels work on.

Layout (measured, see docs/results/simulator.md): LANES designs ride side by side, innermost, as the entries
of one `Vector.field(LANES)`, so that LLVM emits vector loads and stores; a block of them belongs to one thread. The
environment variable FABDESIGN_LANES, read once, sets LANES: 8 for batches; with 2 a lone design takes a third less. The
three components of a vector lie in one element of WIDE entries, component by component: one address for three.

Arrays over nodes are planes of `F.node` (numbers) and `F.node3` (vectors): node (row j, column i) of an nv x nu grid
is entry `F.plane_name + k`, k = (j + 1)(nu + 2) + i + 1: a ring of zero ghosts lies around.
Arrays over fixed points are planes of `F.point` and `F.point3`, `X.plane_name + index`. An interval of a muscle has the
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

from fabdesign.errors import InputError

os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
try:
    import taichi as ti
except ImportError as error:  # a bare machine lacks libX11
    raise InputError(f"cannot load taichi ({error}); on Debian: apt install libx11-6") from error

from sim.kernels.frontend import brief  # after the error above
from sim.kernels.vector_width import widen


def _lanes() -> int:
    given = os.environ.get("FABDESIGN_LANES", "8")
    if given not in {"1", "2", "4", "8", "16"}:
        raise InputError(f"FABDESIGN_LANES is {given!r}; expected 1, 2, 4, 8 or 16")
    return int(given)


LANES = _lanes()
WIDE = 3 * LANES
SPREAD = 512  # iterations of an outer loop that Taichi gives a thread at least: block b is iteration SPREAD b
FUNCTIONALS = 7  # of the warped displacement at a fixed point: u, v, w, (w s_u), (w s_v), w_u, w_v
GREEN = 27  # numbers kept for each pair of fixed points: uu, vv, and 5 x 5 of the normal component
PATCH = 16  # nodes in a row that a fixed point may touch at most
TYPES = 8  # muscle types in one batch
PAIR = 5  # numbers of a pair in contact: place in the cell along u and v, side, thickness [m], stiffness [N/m]
COARSE_ACROSS, COARSE_DOWN, COARSE_SAMPLES = (
    6,
    6,
    10,
)  # of the preconditioner's coarse space (sim/solver/coarse_space.py)
COARSE = 3 * COARSE_ACROSS * COARSE_DOWN  # a multiple of four
TABLE = (101, 701)  # pressures 0 ... 1000 kPa, contractions -0.25 ... 0.45
PRESSURE_STEP = 10e3  # Pa
FIRST_CONTRACTION, CONTRACTION_STEP = -0.25, 0.001

# per-lane constants, entries of F.lane
(
    HU, HV, IHU, IHV, KH1, KH2, K12, SH, D1, D2, D12, B1, B2, TW, VISC, AIR, GX, GY, GZ, AREA,
    MBAR, DTOP, DBOT, TG, DCLAMP, Q1, R1, Q2, R2,
) = range(29)  # fmt: skip
LANE_CONSTANTS = 32
# of a lane's step, entries of F.scheme (sim/time/scheme.py)
H, AM, AF, GAMMA, IA, RY, BA, CA, CV, GOES_ON, CARRIED = range(11)
SCHEME = 11

_NODE3 = dict.fromkeys((
    # state: positions, velocities, accelerations, and those of the step before; q and v at the evaluation point
    "x0", "v0", "a0", "xp", "vp", "q", "v", "hv", "ha",
    # residual f; conjugate gradients: residual r, preconditioned y, direction p
    "f", "carry", "r", "y", "p",
    # unit tangents of edges; node normals; forces of constraints; smooth frames of the preconditioner
    "tu", "tv", "n", "na", "nb", "ca", "cb", "cd", "pu", "pv", "fu", "fn",
), 1)  # fmt: skip
_NODE = dict.fromkeys((
    # of edges: strains, tensions; bending moments; lumped mass [kg]; 1 where free and 0 where held
    "eu", "ev", "su", "sv", "s1", "s2", "mass", "free",
), 1)  # fmt: skip
_POINT3 = dict.fromkeys((
    # values at fixed points and derivatives along u and v, six planes for sim.forces.muscles.sample: of positions and
    # velocities; of the preconditioner's axes along u and normal
    "pos", "tan_u", "tan_v", "vel", "vel_u", "vel_v",
    "fu", "fu_u", "fu_v", "fn", "fn_u", "fn_v",
    "normal", "force", "dir", "grad_u", "grad_v",
), 1)  # fmt: skip
_POINT = {
    "wu": PATCH, "wv": PATCH, "du": PATCH, "dv": PATCH,
    "offset": 1, "active": 1, "rest": 1, "viscosity": 1,
    "gain": 1, "inv_area": 1, "eps": 1, "rate": 1, "pressure": 1, "tension": 1, "compliance": 1, "lam": 1,
    "coef": 2 * FUNCTIONALS, "resp": FUNCTIONALS,
}  # fmt: skip

# planes of F.coarse: both Galerkin matrices; curvatures at the samples, their sums across; how modes stretch four
# intervals; right sides
_COARSE = {
    "coupled": COARSE**2, "alone": COARSE**2, "sample": 8 * COARSE_SAMPLES**2,
    "line": COARSE_ACROSS**2 * COARSE_SAMPLES, "pull": 4 * COARSE, "ratio": 16, "right": 2 * COARSE,
}  # fmt: skip
# of C.shared: products of two modes at the samples, across and down; of the modes down: eigenvalues, bending, clamp;
# then the modes down by rows
_SHARED = {
    "across": 6 * COARSE_ACROSS**2 * COARSE_SAMPLES, "down": 3 * COARSE_DOWN**2 * COARSE_SAMPLES,
    "stiffness": COARSE_DOWN, "bending": COARSE_DOWN**2, "clamp": COARSE_DOWN**2, "rows": 0,
}  # fmt: skip

F: Any = SimpleNamespace(ready=False)
X: Any = SimpleNamespace()
C: Any = SimpleNamespace()
lock = threading.RLock()


def _offsets(planes: dict[str, int], size: int) -> tuple[dict[str, int], int]:
    offsets, total = {}, 0
    for name, width in planes.items():
        offsets[name] = total
        total += width * size
    return offsets, total


@brief()  # fields too keep where they come from
def allocate(nodes: int, points: int, modes: int, *, blocks: int) -> None:
    """Start Taichi with room for `blocks` blocks of grids of `nodes` padded nodes (at most `modes` across), `points`
    fixed points. Does nothing where there is room already: a second start would drop all arrays and compile again."""
    if F.ready and F.nodes >= nodes and F.points >= points and F.modes >= modes and F.blocks >= blocks:
        return
    grow = (lambda now, then: max(now, then)) if F.ready else (lambda now, then: then)
    modes += -modes % 4
    nodes, points = grow(getattr(F, "nodes", 0), nodes), grow(getattr(F, "points", 0), points)
    modes, blocks = grow(getattr(F, "modes", 0), modes), grow(getattr(F, "blocks", 0), blocks)
    kept = {}  # compiled kernels of other width lie in Taichi's own folder
    if widen():
        kept["offline_cache_file_path"] = ti.lang.impl.default_cfg().offline_cache_file_path + "_wide"
    with contextlib.redirect_stdout(io.StringIO()):
        ti.init(arch=ti.cpu, default_fp=ti.f32, offline_cache=True, advanced_optimization=False, **kept)
    vector = lambda n, width=LANES: ti.Vector.field(width, ti.f32, shape=(blocks, n))  # noqa: E731
    whole = lambda n: ti.Vector.field(LANES, ti.i32, shape=(blocks, n))  # noqa: E731
    F.__dict__.update(nodes=nodes, points=points, modes=modes, blocks=blocks)
    for space, field, planes, size in (
        (F, "node3", _NODE3, nodes),
        (F, "node", _NODE, nodes),
        (X, "point3", _POINT3, points),
        (X, "point", _POINT, points),
    ):
        offsets, total = _offsets(planes, size)
        space.__dict__.update(offsets)
        setattr(F, field, vector(total, WIDE if field.endswith("3") else LANES))
    F.base, F.channel, F.kind = whole(points), whole(points), whole(points)
    F.lane, F.scheme, F.reduce, F.row = vector(LANE_CONSTANTS), vector(SCHEME), vector(10), vector(8)
    F.row3, F.patch3 = vector(2 * PATCH, WIDE), vector(PATCH * PATCH, WIDE)
    F.modal3, F.factor3 = vector(3 * nodes, WIDE), vector(3 * nodes, WIDE)
    F.across, F.down = vector(4 * points * modes), vector(4 * points * modes)  # fixed points by modes and by rows
    F.line, F.line3 = vector(3 * modes), vector(modes, WIDE)
    F.rows = ti.Vector.field(2, ti.i32, shape=(blocks, points))  # of a fixed point: the first, how many times four
    F.basis = ti.Vector.field(8, ti.f32, shape=2 * modes * (modes + 6) // 4)  # rows by four, of two bases
    F.eigen = ti.Vector.field(3, ti.f32, shape=modes)  # stretching, bending and slopes (sim/solver/modes.py)
    F.odd = ti.field(ti.i32, shape=())
    F.touched = ti.field(ti.i32, shape=2)  # nodes across and down that a fixed point may touch
    F.green, F.dual = vector(points * points * GREEN), vector(points * points)
    own, total = _offsets(_COARSE, 1)
    shared, numbers = _offsets(_SHARED, 1)
    C.__dict__.update(own | shared)
    F.coarse, F.coarse_down = vector(total), vector(3 * points * COARSE_DOWN)
    C.shared = ti.field(ti.f32, shape=numbers + (modes + 4) * COARSE_DOWN)
    C.place = ti.field(ti.i32, shape=COARSE_ACROSS + COARSE_SAMPLES + 32)
    F.table = ti.field(ti.f32, shape=(TYPES, *TABLE))
    # in contact: each node meets two layers at most
    F.pairs = ti.field(ti.i32, shape=blocks)
    F.pair_node, F.pair_cell, F.pair = whole(2 * nodes), whole(2 * nodes), vector(2 * nodes * PAIR)
    longest = max(F.node3.shape[1], F.point.shape[1], F.across.shape[1], F.coarse.shape[1])  # of all loops
    F.after = ti.field(ti.i32, shape=longest)  # filled with the first batch
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
        with brief():
            result = self.kernel(*arguments)
        _compile_seconds[0] += time.perf_counter() - begin
        self.start = F.node
        return result
