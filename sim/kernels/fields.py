"""The one owner of Taichi: starts it, and makes room for all that is declared (sim/state.py).

Layout (measured, see docs/lab/simulator.md): LANES designs ride side by side, innermost, as the entries
of one `Vector.field(LANES)`, so that LLVM emits vector loads and stores; a block of them belongs to one thread. The
environment variable FABDESIGN_LANES, read once, sets LANES: 8 for batches; with 2 a lone design takes a third less. The
three components of a vector lie in one element of WIDE entries, component by component: one address for three.

Planes over nodes are parts of `F.node` (numbers) and `F.node3` (vectors): node (row j, column i) of an nv x nu grid
is entry `F.NAME + k`, k = (j + 1)(nu + 2) + i + 1: a ring of zero ghosts lies around. Planes over fixed points are
parts of `F.point` and `F.point3`, entry `X.NAME + index`; an interval of a muscle has the index of its first fixed
point. A declared array is a field of its own, `F.NAME`. Offsets are constants of the compiled kernels; grid size and
counts are run-time values.

Inner loops are `for k in indices(count)`, made `while` loops that step by `k = F.after[k]`, which is k + 1: where LLVM
foresees the next index, it spends nine tenths of the compile time on the loop.
"""

import ast
import contextlib
import io
import itertools
import mmap
import os
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from fabdesign.errors import InputError, why_not_loaded
from fabdesign.runtime.shortage import ensure_cache_folder, remove_stale_lock, require_writable
from fabdesign.runtime.working_time import not_counted

os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
try:
    ensure_cache_folder()  # without one Taichi ends by a segmentation fault
    require_writable("TI_OFFLINE_CACHE_FILE_PATH")
    import taichi as ti
    from taichi.lang.ast.ast_transformer import ASTTransformer, build_stmt
except ImportError as error:
    raise InputError(f"cannot load taichi ({error}){why_not_loaded(error)}") from error

from sim import state  # after the error above
from sim.kernels.frontend import HIDDEN_STEPS, brief, first_call, wanted
from sim.kernels.ownership import mark, require_no_fork, require_unshared, runtime, watch_forks
from sim.materials import CONSTANTS
from sim.time_steps import ENTRIES


def _lanes() -> int:
    given = os.environ.get("FABDESIGN_LANES", "8")
    if given not in {"1", "2", "4", "8", "16"}:
        raise InputError(f"FABDESIGN_LANES is {given!r}; expected 1, 2, 4, 8 or 16")
    return int(given)


LANES = _lanes()
WIDE = 3 * LANES
SPREAD = 512  # iterations of an outer loop that Taichi gives a thread at least: block b is iteration SPREAD b
TYPES = 8  # muscle types in one batch
TABLE = (101, 701)  # pressures 0 ... 1000 kPa, contractions -0.25 ... 0.45
PRESSURE_STEP = 10e3  # Pa
FIRST_CONTRACTION, CONTRACTION_STEP = -0.25, 0.001
SLOTS = 32  # columns of a lane at a time: kernels are compiled for the very fields
OF_NODES, OF_POINTS = ("node3", "node"), ("point3", "point")  # fields whose parts are planes


class FieldSpace(SimpleNamespace):
    """FieldSpace of Taichi, and where the planes in them begin, by the names of sim/state.py."""

    nodes: int  # the room there is (sim.state.Sizes)
    points: int
    modes: int
    blocks: int
    ready: bool  # whether all are there

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


F, X, C = FieldSpace(ready=False), FieldSpace(), FieldSpace()
T = FieldSpace(start=None)  # what derivatives need beside: a `d` stands for the change of a plane in a direction
lock = threading.RLock()
watch_forks(lock)
_POOL = 1 << 30  # bytes of addresses that Taichi reserves


@brief()  # fields too keep where they come from
def allocate(nodes: int, points: int, modes: int, *, blocks: int) -> None:
    """Start Taichi with room for `blocks` blocks of grids of `nodes` padded nodes (at most `modes` across), `points`
    fixed points. Does nothing where there is room already: a second start would drop all arrays and compile again."""
    require_no_fork()
    F.ready = F.ready and F.runtime is runtime()  # else other code has started Taichi
    declared = len(state.PLANES), len(CONSTANTS)
    ready = F.ready and declared == F.declared
    if ready and F.nodes >= nodes and F.points >= points and F.modes >= modes and F.blocks >= blocks:
        return
    had = F.__dict__ if F.ready else {}
    sizes = state.Sizes(
        nodes=max(nodes, had.get("nodes", 0)),
        points=max(points, had.get("points", 0)),
        modes=max(modes + -modes % 4, had.get("modes", 0)),
    )
    blocks = max(blocks, had.get("blocks", 0))
    require_unshared()
    _require_address_space()
    kept = {} if "TI_OFFLINE_CACHE" in os.environ else {"offline_cache": True}  # the user's goes first
    remove_stale_lock(
        Path(os.environ.get("TI_OFFLINE_CACHE_FILE_PATH") or ti.lang.impl.default_cfg().offline_cache_file_path)
    )
    with not_counted(), contextlib.redirect_stdout(io.StringIO()):
        ti.init(arch=ti.cpu, default_fp=ti.f32, advanced_optimization=False, log_level=ti.CRITICAL, **kept)
    F.__dict__.update(sizes.__dict__, blocks=blocks, declared=declared)
    try:
        _make_fields(sizes, blocks)
        _make_shared(sizes, blocks)
        F.after = ti.field(ti.i32, shape=longest_loop()) if wanted(HIDDEN_STEPS) else Following()  # filled with a batch
    finally:
        mark(F, C)  # also where it is interrupted
    F.runtime, F.ready = runtime(), True


def _require_address_space() -> None:
    """Raise MemoryError where Taichi would get no room for its pool, which it reserves at once: it prints more than a
    line when it is refused."""
    if hasattr(mmap, "MAP_NORESERVE"):
        try:
            mmap.mmap(-1, _POOL, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | mmap.MAP_NORESERVE).close()
        except OSError:
            raise MemoryError(f"the simulator reserves {_POOL / 1e9:.2g} GB of addresses") from None


class Following:
    """k + 1 in place of a table of it."""

    def __getitem__(self, k: Any) -> Any:
        return k + 1


def indices(*ends: int) -> range:
    """Return the whole numbers that an inner loop of a kernel goes through, as `range` does."""
    return range(*ends)


def _build_for(context: Any, loop: ast.For, *, of_taichi: Any = ASTTransformer.build_For) -> None:
    """Make of a loop through `indices` in a kernel the `while` loop; others are left to Taichi."""
    call, k = loop.iter, loop.target
    if not isinstance(call, ast.Call) or context.global_vars.get(getattr(call.func, "id", "")) is not indices:
        of_taichi(context, loop)
        return
    first, end = [ast.Constant(0), *call.args][-2:]
    context.global_vars["F.after"] = F.after
    following = ast.Subscript(ast.Name("F.after", ast.Load()), k, ast.Load())
    steps = ast.While(ast.Compare(k, [ast.Lt()], [end]), [*loop.body, ast.Assign([k], following)], [])
    for statement in (ast.Assign([k], first), steps):
        build_stmt(context, ast.fix_missing_locations(ast.copy_location(statement, loop)))


ASTTransformer.build_For = staticmethod(_build_for)


def _make_fields(sizes: state.Sizes, blocks: int) -> None:
    """Make the fields that each lane has of its own."""

    def field(size: int, *, vector: bool = False, integer: bool = False) -> Any:
        return ti.Vector.field(WIDE if vector else LANES, ti.i32 if integer else ti.f32, shape=(blocks, size))

    for space, names, places in ((F, OF_NODES, sizes.nodes), (X, OF_POINTS, sizes.points)):
        for name in names:
            begins, total = state.offsets(state.planes(name), places)
            space.__dict__.update(begins)
            setattr(F, name, field(total, vector=name.endswith("3")))
    F.lane, F.scheme = field(len(CONSTANTS)), field(len(ENTRIES))
    for array in state.ARRAYS:
        setattr(F, array.name, field(array.size(sizes), vector=array.vector, integer=array.integer))
    C.__dict__.update(_begins(state.COARSE_PARTS))


def _make_shared(sizes: state.Sizes, blocks: int) -> None:
    """Make the fields that the lanes of a block, or all of them, have in common."""
    modes, down = sizes.modes, state.COARSE_DOWN
    F.rows = ti.Vector.field(2, ti.i32, shape=(blocks, sizes.points))  # of a fixed point: first, how many times four
    F.pairs = ti.field(ti.i32, shape=blocks)  # how many there are in contact
    F.basis = ti.Vector.field(8, ti.f32, shape=2 * modes * (modes + 6) // 4)  # rows by four, of two bases
    F.eigen = ti.Vector.field(3, ti.f32, shape=modes)  # stretching, bending and slopes (sim/solver/modes.py)
    F.odd = ti.field(ti.i32, shape=())
    F.touched = ti.field(ti.i32, shape=2)  # nodes across and down that a fixed point may touch
    F.table = ti.field(ti.f32, shape=(TYPES, *TABLE))
    C.__dict__.update(_begins(state.COARSE_SHARED))
    C.shared = ti.field(ti.f32, shape=sum(state.COARSE_SHARED.values()) + (modes + 4) * down)
    C.place = ti.field(ti.i32, shape=state.COARSE_ACROSS + state.COARSE_SAMPLES + 32)


def allocate_tangent() -> None:
    """Make room for T at its first use, and where the simulator's own fields are other ones than the last time: planes
    over nodes and points as above, parts of `T.node`, `T.node3`, `T.point3`, and in `T.columns` a vector plane for each
    of SLOTS columns."""
    if T.start is F.node:
        return

    def planes(names: tuple[str, ...], places: int, width: int) -> Any:
        T.__dict__.update({name: k * places for k, name in enumerate(names)})
        return ti.Vector.field(width, ti.f32, shape=(F.blocks, len(names) * places))

    try:
        T.node = planes(("d_eu", "d_ev", "d_su", "d_sv", "d_s1", "d_s2"), F.nodes, LANES)
        T.node3 = planes(("d_tu", "d_tv", "d_n", "x"), F.nodes, WIDE)
        T.point3 = planes(("d_normal", "d_force"), F.points, WIDE)
        T.columns = ti.Vector.field(WIDE, ti.f32, shape=(F.blocks, SLOTS * F.nodes))
        T.outcome = ti.Vector.field(LANES, ti.i32, shape=(F.blocks, SLOTS))  # what came of a column
    finally:
        mark(T)
    T.start = F.node


def longest_loop() -> int:
    """Return the longest of all loops: one that steps beyond the table of steps need not end."""
    shapes = [value.shape for space in (F, C) for value in vars(space).values() if hasattr(value, "shape")]
    return max(entries for shape in shapes for entries in shape)


def _begins(parts: dict[str, int]) -> dict[str, int]:
    return dict(zip(parts, itertools.accumulate(parts.values(), initial=0), strict=False))


def floats(axes: int) -> Any:
    """Return what a kernel says of an array of numbers with so many axes."""
    return ti.types.ndarray(dtype=ti.f32, ndim=axes)


def ints(axes: int) -> Any:
    """Return the same of whole numbers."""
    return ti.types.ndarray(dtype=ti.i32, ndim=axes)


class Timed:
    """A kernel whose first call after a start of Taichi compiles or loads it, which is nobody's time. costly: what it
    computes, where it takes long to compile."""

    def __init__(self, kernel: Any, costly: str = "") -> None:
        self.kernel, self.costly, self.start = kernel, costly, None

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        if self.start is F.node:
            return self.kernel(*arguments, **named)
        with first_call(self.costly, (F.nodes, F.points, F.modes, F.blocks, LANES)):
            result = self.kernel(*arguments, **named)
        self.start = F.node
        return result
