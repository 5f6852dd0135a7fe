"""The fields that derivatives need beside the simulator's, made at their first use.

Planes over nodes and points as in sim/kernels/fields.py, parts of `T.node`, `T.node3`, `T.point3`; `T.columns` holds a
vector plane for each of SLOTS columns. A `d` stands for the change of a plane of that name in a direction.
"""

from types import SimpleNamespace
from typing import Any

import taichi as ti

from sim.kernels.fields import LANES, WIDE, F
from sim.kernels.ownership import mark

SCALARS = ("d_eu", "d_ev", "d_su", "d_sv", "d_s1", "d_s2")
VECTORS = ("d_tu", "d_tv", "d_n", "x")
POINT_VECTORS = ("d_normal", "d_force")

SLOTS = 32  # columns of a lane at a time: kernels are compiled for the very fields

T: Any = SimpleNamespace(start=None)


def allocate() -> None:
    """Make them, where the simulator's own fields are other ones than the last time."""
    if T.start is F.node:
        return
    try:
        T.node = _planes(SCALARS, F.nodes, LANES)
        T.node3 = _planes(VECTORS, F.nodes, WIDE)
        T.point3 = _planes(POINT_VECTORS, F.points, WIDE)
        T.columns = ti.Vector.field(WIDE, ti.f32, shape=(F.blocks, SLOTS * F.nodes))
        T.found = ti.Vector.field(LANES, ti.i32, shape=(F.blocks, SLOTS))  # what came of a column
    finally:
        mark(T)
    T.start = F.node


def _planes(names: tuple[str, ...], places: int, width: int) -> Any:
    T.__dict__.update({name: k * places for k, name in enumerate(names)})
    return ti.Vector.field(width, ti.f32, shape=(F.blocks, len(names) * places))
