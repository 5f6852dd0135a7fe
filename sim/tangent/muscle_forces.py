"""Forces of muscles on a cloth in float64, on the host: equations 7 to 10 of docs/model.md with the smooth law itself.

For right sides of derivatives: what a moved end or a pressure changes is small beside what single precision leaves of
the forces, and the kernels' table of the law has slopes of its own between its grid lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.muscle import BenchTable, Muscle, MuscleType
from fabdesign.nouns.muscle_law import law_of
from sim.lacing import line_weights

AT_ONCE = 1_000_000  # nodes around fixed points


@dataclass(frozen=True, eq=False)
class Strand:
    """One muscle of a specimen under pressure. lent, friction: as in a MuscleRecord, of all its intervals or (k,) of
    each."""

    muscle: Muscle
    type: MuscleType
    pressure: float  # Pa, at its first end
    gain: float  # on what pressure adds to the tension
    lever: float  # factor on the axis' offset
    loss: float  # share of the pressure lost to its far end
    lent: float | Array = 0.0  # of contraction
    friction: float | Array = 0.0  # N

    def is_like(self, other: "Strand") -> bool:
        """Return whether both pull alike. Comparing types would compare their bench tables."""
        ours, others = ((s.pressure, s.gain, s.lever, s.loss, s.muscle) for s in (self, other))
        remembered = zip((self.lent, self.friction), (other.lent, other.friction), strict=True)
        return self.type is other.type and ours == others and all(np.array_equal(a, b) for a, b in remembered)


@dataclass(frozen=True, eq=False)
class Pull:
    """The pull of a strand on one shape, with a weight, and to which sum of forces that is added."""

    strand: Strand
    shape: int
    weight: float
    sum: int


@dataclass(frozen=True)
class Grid:
    """n x n nodes; a loop touches at most `across` x `down` of them."""

    n: int
    across: int
    down: int


def summed(pulls: Sequence[Pull], shapes: Array, spacing: Array, grid: Grid, sums: int) -> Array:
    """Return (sums, n n, 3) N: forces on the nodes, times the weights. shapes (s, n n, 3) m; spacing (s, 2) m along u,
    v."""
    nodes = grid.n**2
    total = np.zeros((3, sums * nodes))
    points = _fixed_points(pulls)
    behind = np.cumsum([len(places) for places in points])
    part = behind * grid.across * grid.down // AT_ONCE
    for k in np.unique(part):
        first, end = np.searchsorted(part, (k, k + 1))
        place, forces = _on_nodes(pulls[first:end], points[first:end], shapes, spacing, grid)
        for component, force in zip(total, forces, strict=True):
            component += np.bincount(place.ravel(), force.ravel(), sums * nodes)
    return np.moveaxis(total.reshape(3, sums, nodes), 0, -1)


class _Loops(NamedTuple):
    """The cloth at p fixed points, each held by the nodes around it. touched: (p, down, across) nodes, with weights
    along u (p, across) and v (p, down) and their slopes; area: (p, 1), of the tangents (p, 3) along u and v; axis: (p,
    3) m, of the muscle, `offset` (p, 1) m off the cloth along the normal (p, 3)."""

    touched: NDArray[np.int_]
    weights: tuple[tuple[Array, Array], tuple[Array, Array]]
    tangents: tuple[Array, Array]
    area: Array
    normal: Array
    offset: Array
    axis: Array


def _loops(at: Array, shape: NDArray[np.int_], offset: Array, shapes: Array, spacing: Array, grid: Grid) -> _Loops:
    """Return the cloth at places (p, 2) m of shapes, of each place (p,) which. offset: (p,) m."""
    (i, wu, du, _), (j, wv, dv, _) = (
        line_weights(at[:, axis], grid.n, spacing[shape, axis, None], count)
        for axis, count in enumerate((grid.across, grid.down))
    )
    touched = (j[:, None, None] + np.arange(grid.down)[:, None]) * grid.n + i[:, None, None] + np.arange(grid.across)
    around = shapes[shape[:, None, None], touched]
    rows, rows_u = (np.einsum("pi,pjic->pjc", weights, around) for weights in (wu, du))
    cloth, along_u, along_v = (
        np.einsum("pj,pjc->pc", weights, part) for weights, part in ((wv, rows), (wv, rows_u), (dv, rows))
    )
    across = np.cross(along_v, along_u)
    area = np.linalg.norm(across, axis=1, keepdims=True)
    normal, off = across / area, offset[:, None]
    return _Loops(touched, ((wu, du), (wv, dv)), (along_u, along_v), area, normal, off, cloth + off * normal)


def _on_nodes(
    pulls: Sequence[Pull], points: Sequence[Array], shapes: Array, spacing: Array, grid: Grid
) -> tuple[NDArray[np.int_], Array]:
    """Return of the nodes around each fixed point their place among all sums' nodes (p, down, across), forces (3, p,
    down, across) N times the weights."""
    # (p,) the pull that a fixed point belongs to
    of, at = np.repeat(np.arange(len(pulls)), [len(places) for places in points]), np.concatenate(points)
    shape = np.array([pull.shape for pull in pulls])[of]
    offset = np.array([offset_of(p.strand.muscle, p.strand.type, p.strand.lever) for p in pulls])[of]
    loops = _loops(at, shape, offset, shapes, spacing, grid)
    normal, (along_u, along_v), ((wu, du), (wv, dv)) = loops.normal, loops.tangents, loops.weights
    force = _pulls(pulls, at, of, loops.axis) * np.array([pull.weight for pull in pulls])[of, None]
    couple = loops.offset * (force - np.sum(force * normal, axis=1, keepdims=True) * normal) / loops.area
    grad_u, grad_v = np.cross(couple, along_v), np.cross(along_u, couple)
    by_row = wv[..., None] * force[:, None] + dv[..., None] * grad_v[:, None]
    on_nodes = np.einsum("pi,pjc->cpji", wu, by_row) + np.einsum("pi,pj,pc->cpji", du, wv, grad_u)
    place = np.array([pull.sum for pull in pulls])[of, None, None] * grid.n**2 + loops.touched
    return place, on_nodes


def contractions(muscle: Muscle, offset: float, shapes: Array, spacing: Array, grid: Grid) -> Array:
    """Return (s, k): the contraction of a muscle's intervals on shapes (s, n n, 3) m. offset: m, of its axis
    (offset_of); spacing: (2,) m along u, v."""
    at, count = muscle.fixed_points(), len(shapes)
    shape = np.repeat(np.arange(count), len(at))
    everywhere = np.broadcast_to(spacing, (count, 2))
    loops = _loops(np.tile(at, (count, 1)), shape, np.full(len(shape), offset), shapes, everywhere, grid)
    axis = loops.axis.reshape(count, len(at), 3)
    rest = np.linalg.norm(np.diff(at, axis=0), axis=1)
    return np.asarray(1 - np.linalg.norm(np.diff(axis, axis=1), axis=2) / rest)


def _fixed_points(pulls: Sequence[Pull]) -> list[Array]:
    known = {id(pull.strand.muscle): pull.strand.muscle for pull in pulls}
    points = {key: muscle.fixed_points() for key, muscle in known.items()}
    return [points[id(pull.strand.muscle)] for pull in pulls]


def offset_of(muscle: Muscle, kind: MuscleType, lever: float) -> float:
    """Return the offset [m] of a muscle's axis, positive on the front."""
    return (1 if muscle.side == "front" else -1) * lever * kind.axis_offset


def _pulls(pulls: Sequence[Pull], at: Array, of: NDArray[np.int_], points: Array) -> Array:
    """Return (p, 3) N: what the intervals pull their fixed points with. at: (p, 2) m on the flat cloth."""
    same = of[1:] == of[:-1]
    begin, of = np.flatnonzero(same), of[1:][same]
    rest = np.linalg.norm(at[begin + 1] - at[begin], axis=1)
    apart = points[begin + 1] - points[begin]
    length = np.linalg.norm(apart, axis=1)
    rest_lengths = np.bincount(of, rest, len(pulls))
    through = np.cumsum(rest) - rest / 2 - (np.cumsum(rest_lengths) - rest_lengths)[of]  # to the interval's middle
    pressure, gain, loss = np.array([(p.strand.pressure, p.strand.gain, p.strand.loss) for p in pulls])[of].T
    counts = np.bincount(of, minlength=len(pulls))
    lent, friction = (
        np.concatenate([np.broadcast_to(value, count) for value, count in zip(values, counts, strict=True)])
        for values in zip(*((p.strand.lent, p.strand.friction) for p in pulls), strict=True)
    )
    benches = [pull.strand.type.bench for pull in pulls]
    along = pressure * (1 - loss * through / rest_lengths[of])
    tension = _tensions(benches, of, along, gain, 1 - length / rest - lent) - friction
    pull = (tension / length)[:, None] * apart
    force = np.zeros_like(points)
    force[begin] += pull
    force[begin + 1] -= pull
    return force


def _tensions(
    benches: Sequence[BenchTable], of: NDArray[np.int_], pressure: Array, gain: Array, contraction: Array
) -> Array:
    """Return (intervals,) N, each by the bench table of what it is `of`."""
    tension = np.zeros(len(of))
    keys = np.array([id(bench) for bench in benches])[of]
    for key, bench in {id(bench): bench for bench in benches}.items():
        member, law = keys == key, law_of(bench)
        idle = law.tension(0.0, contraction[member])
        tension[member] = idle + gain[member] * (law.tension(pressure[member], contraction[member]) - idle)
    return tension
