"""The state that the kernels work on, declared once: name, on what, unit, and how long its values last.

A plane holds a number (or a vector of three) for every place of one sort: nodes and what counts as they do (edges along
u and v and cells, by the node at which they begin), fixed points and the intervals that begin there. An array holds
what has another shape. All of these are there for each lane; sim/kernels/fields.py makes room for them, and loading
(sim/kernels/transfer.py) takes them by name and zeroes by their `life`. Constants of a lane are the table of
sim/materials.py, those of its step that of sim/time_steps.py.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Literal


class Life(Enum):
    """How long values last.

    LOADED: put there by every batch. CARRIED: zero when a batch is loaded, then carried from step to step. WORK: zero
    when a batch is loaded; a step writes before it reads. SCRATCH: the same, but too large to be zeroed: nothing is
    read that was not written since. REMEMBERED: carried, by an added force, which writes its memory as at the end
    of the step to the plane NAME_next: that replaces it when the step is done, and no sooner.
    """

    LOADED, CARRIED, WORK, SCRATCH, REMEMBERED = range(5)


LOADED, CARRIED, WORK, SCRATCH, REMEMBERED = Life
Entity = Literal["node", "edge", "cell", "fixed point", "interval"]
BY_NODE, BY_POINT = ("node", "edge", "cell"), ("fixed point", "interval")
NEXT = "_next"  # of the plane to which an added force writes

FUNCTIONALS = 7  # of a displacement in local frames at a fixed point: u, v, w, (w s_u), (w s_v), w_u, w_v
GREEN = 27  # numbers kept for each pair of fixed points: uu, vv, and 5 x 5 of the normal component
PATCH = 16  # nodes in a row that a fixed point may touch at most
PAIR = 5  # numbers of a pair in contact: place in the cell along u and v, side, thickness [m], stiffness [N/m]
COARSE_ACROSS, COARSE_DOWN, COARSE_SAMPLES = 6, 6, 10  # of the coarse space (sim/solver/coarse_space.py)
COARSE = 3 * COARSE_ACROSS * COARSE_DOWN  # a multiple of four


@dataclass(frozen=True)
class Plane:
    name: str
    on: Entity
    unit: str  # "1" for a number without one
    life: Life
    what: str
    vector: bool = False
    entries: int = 1  # numbers for each place

    @property
    def field(self) -> str:
        """Return the field of sim.kernels.fields.F that the plane is a part of."""
        return ("node" if self.on in BY_NODE else "point") + ("3" if self.vector else "")


@dataclass(frozen=True)
class Sizes:
    """Room in the fields."""

    nodes: int  # of a grid, with the ring of zeros around it
    points: int  # fixed points
    modes: int  # of one direction, a multiple of four


@dataclass(frozen=True)
class Array:
    name: str
    size: Callable[[Sizes], int]
    life: Life
    what: str
    vector: bool = False
    integer: bool = False  # of integers


def _node(name: str, unit: str, life: Life, what: str, *, on: Entity = "node") -> Plane:
    return Plane(name, on, unit, life, what, vector=True)


PLANES: list[Plane] = [
    # the state of the motion, and of the step before
    _node("x0", "m", LOADED, "positions at the step's begin; loaded: at rest on the flat cloth"),
    _node("v0", "m/s", CARRIED, "velocities there"),
    _node("a0", "m/s^2", CARRIED, "accelerations there"),
    _node("xp", "m", CARRIED, "positions at the begin of the step before, for frames"),
    _node("vp", "m/s", CARRIED, "velocities there"),
    # a step's evaluation
    _node("q", "m", LOADED, "positions at the step's evaluation, its unknowns; loaded as x0"),
    _node("v", "m/s", WORK, "velocities at q"),
    _node("hv", "m/s", WORK, "v = cv (q - x0) + hv"),
    _node("ha", "m/s^2", WORK, "a = ca (q - x0) + ha"),
    _node("f", "N", WORK, "forces - M a"),
    _node("lead", "m", WORK, "where springs lead the cloth (sim/forces/lead.py)"),
    _node("carried", "N", CARRIED, "residual that the step before left, and that acts in this one"),
    # conjugate gradients
    _node("r", "N", WORK, "residual"),
    _node("y", "m", WORK, "preconditioned residual"),
    _node("p", "m", WORK, "direction"),
    # geometry
    _node("tu", "1", WORK, "unit tangents along u", on="edge"),
    _node("tv", "1", WORK, "unit tangents along v", on="edge"),
    _node("n", "1", WORK, "unit normals"),
    # forces of constraints on the nodes that they tie together
    _node("na", "N", WORK, "of bending, on the neighbours along u"),
    _node("nb", "N", WORK, "of bending, on the neighbours along v"),
    _node("ca", "N", WORK, "of shear and twist, by the mean edge along u", on="cell"),
    _node("cb", "N", WORK, "of shear and twist, by the mean edge along v", on="cell"),
    _node("cd", "N", WORK, "of twist, by the mixed difference", on="cell"),
    _node("pu", "N", WORK, "pull of the edges along u", on="edge"),
    _node("pv", "N", WORK, "pull of the edges along v", on="edge"),
    # smooth local frames of the preconditioner
    _node("fu", "1", WORK, "axis along u"),
    _node("fn", "1", WORK, "normal axis"),
    Plane("eu", "edge", "1", WORK, "strain along u"),
    Plane("ev", "edge", "1", WORK, "strain along v"),
    Plane("su", "edge", "N m", WORK, "tension along u times the edge's area"),
    Plane("sv", "edge", "N m", WORK, "tension along v times the edge's area"),
    Plane("s1", "node", "N m", WORK, "bending moment along u times area over spacing"),
    Plane("s2", "node", "N m", WORK, "bending moment along v times area over spacing"),
    Plane("mass", "node", "kg", LOADED, "lumped mass"),
    Plane("free", "node", "1", LOADED, "1 where a node is free, 0 where it is held"),
    # values at fixed points and their derivatives along u and v, three planes each in this order, as sample (in
    # sim/forces/muscles.py) fills them: of positions and velocities, of the axes of the preconditioner's frames
    Plane("pos", "fixed point", "m", WORK, "position of the cloth, then of the fixed point", vector=True),
    Plane("tan_u", "fixed point", "1", WORK, "tangent along u", vector=True),
    Plane("tan_v", "fixed point", "1", WORK, "tangent along v", vector=True),
    Plane("vel", "fixed point", "m/s", WORK, "velocity of the cloth, then of the fixed point", vector=True),
    Plane("vel_u", "fixed point", "1/s", WORK, "its derivative along u", vector=True),
    Plane("vel_v", "fixed point", "1/s", WORK, "its derivative along v", vector=True),
    Plane("fu", "fixed point", "1", WORK, "axis along u", vector=True),
    Plane("fu_u", "fixed point", "1/m", WORK, "its derivative along u", vector=True),
    Plane("fu_v", "fixed point", "1/m", WORK, "its derivative along v", vector=True),
    Plane("fn", "fixed point", "1", WORK, "normal axis", vector=True),
    Plane("fn_u", "fixed point", "1/m", WORK, "its derivative along u", vector=True),
    Plane("fn_v", "fixed point", "1/m", WORK, "its derivative along v", vector=True),
    Plane("normal", "fixed point", "1", WORK, "unit normal of the cloth", vector=True),
    Plane("force", "fixed point", "N", WORK, "pull of the intervals", vector=True),
    Plane("dir", "interval", "1", WORK, "unit vector along it", vector=True),
    Plane("grad_u", "fixed point", "N m", WORK, "couple of the force, by the tangent along u", vector=True),
    Plane("grad_v", "fixed point", "N m", WORK, "couple of the force, by the tangent along v", vector=True),
    # of the loop that holds the cloth (sim/lacing.py), for each node across and down
    Plane("wu", "fixed point", "1", LOADED, "weights across", entries=PATCH),
    Plane("wv", "fixed point", "1", LOADED, "weights down", entries=PATCH),
    Plane("du", "fixed point", "1/m", LOADED, "derivatives of the weights across", entries=PATCH),
    Plane("dv", "fixed point", "1/m", LOADED, "derivatives of the weights down", entries=PATCH),
    Plane("offset", "fixed point", "m", LOADED, "of the laced axis, positive on the front"),
    Plane("active", "interval", "1", LOADED, "1 where an interval begins, 0 at a muscle's end"),
    Plane("rest", "interval", "m", LOADED, "length on the flat cloth"),
    Plane("viscosity", "interval", "N s", LOADED, "tension lost per contraction rate"),
    Plane("gain", "interval", "1", LOADED, "on what pressure adds to the tension"),
    Plane("pressure_share", "interval", "1", LOADED, "of the channel's pressure that arrives"),
    Plane("inv_area", "fixed point", "1", WORK, "1 / |X_v x X_u|"),
    Plane("eps", "interval", "1", WORK, "contraction"),
    Plane("rate", "interval", "1/s", WORK, "contraction rate"),
    Plane("pressure", "interval", "Pa", WORK, "in this step"),
    Plane("tension", "interval", "N", WORK, "tension"),
    Plane("compliance", "interval", "m/N", WORK, "of the tangent in a step, viscosity included"),
    Plane("lam", "interval", "N", WORK, "tensions that answer a displacement"),
    Plane("coef", "interval", "1", WORK, "how the functionals of both ends stretch it", entries=2 * FUNCTIONALS),
    Plane("resp", "fixed point", "m/N", WORK, "functionals that one interval's pull leads to", entries=FUNCTIONALS),
]

BUILT_IN = len(PLANES)  # those behind are added forces'

# parts of the array `coarse`: both Galerkin matrices; curvatures at the samples, their sums across; how modes stretch
# four intervals; right sides
COARSE_PARTS = {
    "coupled": COARSE**2, "alone": COARSE**2, "sample": 8 * COARSE_SAMPLES**2,
    "line": COARSE_ACROSS**2 * COARSE_SAMPLES, "pull": 4 * COARSE, "ratio": 16, "right": 2 * COARSE,
}  # fmt: skip
# of what all lanes share of it: products of two modes at the samples, across and down; of the modes down: eigenvalues,
# bending, clamp; then the modes down by rows
COARSE_SHARED = {
    "across": 6 * COARSE_ACROSS**2 * COARSE_SAMPLES, "down": 3 * COARSE_DOWN**2 * COARSE_SAMPLES,
    "stiffness": COARSE_DOWN, "bending": COARSE_DOWN**2, "clamp": COARSE_DOWN**2, "rows": 0,
}  # fmt: skip

ARRAYS: list[Array] = [
    Array("base", lambda s: s.points, LOADED, "first node that a fixed point touches", integer=True),
    Array("channel", lambda s: s.points, LOADED, "pressure channel of an interval", integer=True),
    Array("muscle_type", lambda s: s.points, LOADED, "of an interval: which table of the law", integer=True),
    Array("across", lambda s: 4 * s.points * s.modes, LOADED, "loops by modes across (sim/solver/muscle_modes.py)"),
    Array("down", lambda s: 4 * s.points * s.modes, LOADED, "loops by rows"),
    Array("coarse_down", lambda s: 3 * s.points * COARSE_DOWN, LOADED, "loops by the coarse space's modes down"),
    Array("reduce", lambda s: 10, CARRIED, "sums over nodes and what follows (sim/solver/conjugate_gradients.py)"),
    Array("aged", lambda s: 1, WORK, "share by which the memory of a stress follows it in this step"),
    Array("row", lambda s: 8, WORK, "functionals at a fixed point"),
    Array("row3", lambda s: 2 * PATCH, WORK, "rows of the nodes around a fixed point", vector=True),
    Array("patch3", lambda s: PATCH * PATCH, WORK, "the nodes around a fixed point; the coarse space", vector=True),
    # a product with a zero entry of the basis must not meet an old NaN
    Array("modal3", lambda s: 3 * s.nodes, WORK, "fields by nodes and by modes across, three planes", vector=True),
    Array("bands3", lambda s: 3 * s.nodes, SCRATCH, "banded factors along v (sim/solver/flat_cloth.py)", vector=True),
    Array("line", lambda s: 3 * s.modes, WORK, "sums over rows, slopes and moments"),
    Array("line3", lambda s: s.modes, WORK, "sums over rows", vector=True),
    Array("green", lambda s: s.points**2 * GREEN, SCRATCH, "Green's functions between fixed points [m/N, 1/N, ...]"),
    Array("dual", lambda s: s.points**2, SCRATCH, "factors of the intervals' compliance matrix [m/N]"),
    Array("coarse", lambda s: sum(COARSE_PARTS.values()), SCRATCH, "the coarse space's matrices and vectors"),
    # in contact: each node meets two layers at most
    Array("pair_node", lambda s: 2 * s.nodes, SCRATCH, "node of a pair in contact", integer=True),
    Array("pair_cell", lambda s: 2 * s.nodes, SCRATCH, "its cell", integer=True),
    Array("pair", lambda s: 2 * s.nodes * PAIR, SCRATCH, "place, side, thickness, stiffness"),
]


def planes(field: str) -> list[Plane]:
    """Return the planes in one field, last the successors of the remembered ones."""
    successors = [replace(plane, name=plane.name + NEXT, life=WORK) for plane in remembered(field)]
    return [plane for plane in PLANES if plane.field == field] + successors


def remembered(field: str) -> list[Plane]:
    """Return the remembered planes of one field."""
    return [plane for plane in PLANES if plane.field == field and plane.life == REMEMBERED]


def offsets(planes: list[Plane], places: int) -> tuple[dict[str, int], int]:
    """Return where each plane begins in its field, and the field's length."""
    begins, total = {}, 0
    for plane in planes:
        begins[plane.name] = total
        total += plane.entries * places
    return begins, total


def loaded() -> set[str]:
    """Return what every batch must put in by name, besides the lanes' constants."""
    return {p.name for p in PLANES if p.life == LOADED} | {a.name for a in ARRAYS if a.life == LOADED}


def added(on: Entity) -> list[str]:
    """Return what added forces load on intervals, numbers of the specimen's muscles, or on nodes, of its places: by
    name."""
    return [plane.name for plane in PLANES[BUILT_IN:] if plane.life == LOADED and plane.on == on]


def declare(*more: Plane) -> None:
    """Declare planes of an added force, by its own file: before the first batch, or the fields are made anew."""
    for plane in more:
        if plane not in PLANES:
            if any(plane.name == other.name and plane.field == other.field for other in PLANES):
                raise ValueError(f"plane {plane.name!r} on {plane.on}s: there is one of this name already")
            PLANES.append(plane)
