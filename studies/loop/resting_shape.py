"""The faces of a cloth at rest from its measured clouds: a spline sheet laid through the points.

Points of several frames, on both faces, with noise and strays, become a mid-surface: a bicubic B-spline whose control
points are fitted to the points' heights over it, with the lengths along and across the cloth kept those of a shape
that a model predicts (iterated closest points with a nearly inextensible sheet). A point that does not say on which
face it lies counts for the mid-surface at first, then for the likelier face, as in `corrector.field`.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BSpline

from fabdesign.geometry.shape import Shape, normals
from fabdesign.geometry.surface import Surface, front_triangles
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.trial import MeasurementSet
from studies.layout_search.target import LoadedTarget

AT_REST = 0.5  # s, the last of a trial in which a cloth counts as at rest
POINTS = 6_000  # of all frames that are fitted, drawn
CONTROLS = 11  # a side
_STRAIN = 0.004  # of the lengths between nodes, that counts as much as
_HEIGHT = 1e-3  # m of a point's height
_SMOOTH = 4e-3  # m, of control points' second differences against the predicted shape's
_PINNED = 1e-4  # m, of the held edge
_SIDED = 8  # rounds from which on points are told apart by face
_ROUNDS = 16
_SOFT = 0.6e-3  # m: how sharply a point is taken for one face's
_FAR = 5.0  # median heights off, from which a point is a stray's
_LEAST_FAR = 2.5e-3  # m, below which it is none


def measured_shapes(measured: MeasurementSet, targets: Sequence[LoadedTarget], predicted: Array, *, seed: int) -> Array:
    """Return (poses, 2 n, 3) m: the cloth's faces in the trials of orders 0, 1, ..., one a target: at rest in the last
    half second, or in the frame at the target's time. predicted: (poses, 2 n, 3) m, as the search had them."""
    by_order = {trial.order: trial for trial in measured.trials}
    shapes = []
    for pose, target in enumerate(targets):
        trial = by_order[pose]
        data = trial.load()
        if target.time is None:
            frames = np.flatnonzero(data.time > data.time[-1] - AT_REST)
        else:
            frames = np.array([np.abs(data.time - target.time).argmin()])
        points = np.concatenate([data.frames[int(k)] for k in frames])
        shapes.append(resting_faces(points, trial.design.fabric, predicted[pose], seed=seed))
    return np.array(shapes)


def resting_faces(points: Array, fabric: Fabric, predicted: Array, *, seed: int = 0) -> Array:
    """Return (2 n n, 3) m, front face then back face as a forward model gives them, of measured points (k, 3) m.

    predicted: (2 n n, 3) m, the shape that a model expects: where the fit begins, and whose lengths it keeps.
    """
    shape = Shape.of(predicted)
    side = shape.side
    points = np.asarray(points, dtype=np.float64)
    if len(points) > POINTS:
        points = np.random.default_rng(seed).choice(points, POINTS, replace=False)
    basis, bending = _basis(side), _second_differences()
    start = shape.middle.reshape(-1, 3)
    controls = np.linalg.lstsq(basis.toarray(), start, rcond=None)[0]
    along = _differences(side, basis)
    lengths = np.linalg.norm(along @ controls, axis=1)
    curved = bending @ controls
    held = np.arange(side if fabric.hung == "top" else 0)  # nodes whose places are known: those of the hung edge
    half = fabric.thickness / 2
    for number in range(_ROUNDS):
        middle = basis @ controls
        rows, height = _heights(middle, side, points, basis)
        face = np.tanh(height * half / _SOFT**2) if number >= _SIDED else np.zeros(len(height))
        off = height - half * face
        kept = np.abs(off) < max(_FAR * float(np.median(np.abs(off))), _LEAST_FAR)
        blocks = [
            (rows[kept] / _HEIGHT, off[kept] / _HEIGHT),
            _kept(along, controls, lengths),
            _towards(curved, bending, controls, _SMOOTH),
            _towards(start[held], basis[held], controls, _PINNED),
        ]
        step = _solve(blocks, controls.size)
        controls = controls + step.reshape(controls.shape)
        if number > _SIDED and np.abs(step).max() < 1e-5:
            break
    grid = (basis @ controls).reshape(side, side, 3)
    return np.concatenate([(grid + s * half * normals(grid)).reshape(-1, 3) for s in (1, -1)])


@lru_cache(maxsize=4)
def _basis(side: int) -> sp.csr_matrix:
    """Return (side side, CONTROLS CONTROLS): the mid-surface's nodes from control points, both by rising v, then rising
    u."""
    knots = np.concatenate([np.zeros(3), np.linspace(0, 1, CONTROLS - 2), np.ones(3)])
    line = BSpline.design_matrix(np.linspace(0, 1, side), knots, 3)
    return sp.csr_matrix(sp.kron(line, line))


def _differences(side: int, basis: sp.csr_matrix) -> sp.csr_matrix:
    """Return the differences between neighbours along u, along v, and across both diagonals, of nodes from control
    points."""
    index = np.arange(side * side).reshape(side, side)
    pairs = [
        (index[:, 1:], index[:, :-1]),
        (index[1:], index[:-1]),
        (index[1:, 1:], index[:-1, :-1]),
        (index[1:, :-1], index[:-1, 1:]),
    ]
    to, of = (np.concatenate([pair[k].ravel() for pair in pairs]) for k in (0, 1))
    return sp.csr_matrix(basis[to] - basis[of])


def _second_differences() -> sp.csr_matrix:
    line = sp.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(CONTROLS - 2, CONTROLS))
    one = sp.identity(CONTROLS)
    return sp.csr_matrix(sp.vstack([sp.kron(line, one), sp.kron(one, line)]))


def _heights(middle: Array, side: int, points: Array, basis: sp.csr_matrix) -> tuple[sp.csr_matrix, Array]:
    """Return (k, 3 controls) of the nearest places along their triangles' normals, and (k,) m heights over the
    triangles' planes: a point beyond a hem counts by its height alone."""
    triangles = front_triangles(side, side)
    surface = Surface(middle, triangles)
    nearest = surface.nearest(points)
    corners = triangles[nearest.triangle]
    normals = surface.normals_of(nearest.triangle)
    place = np.einsum("kc,kcd->kd", nearest.weights, middle[corners])
    height = np.einsum("kd,kd->k", points - place, normals)
    index = np.repeat(np.arange(len(points)), 3)
    rows = sp.csr_matrix((nearest.weights.ravel(), (index, corners.ravel())), shape=(len(points), len(middle)))
    return _projected(rows @ basis, normals), height


def _projected(rows: sp.csr_matrix, directions: Array) -> sp.csr_matrix:
    """Return (k, 3 controls) of the rows' points along directions (k, 3); unknowns are x, y, z of a control point by
    turns."""
    coordinates = [sp.csr_matrix(sp.diags(directions[:, d]) @ rows) for d in range(3)]
    stacked = sp.hstack(coordinates, format="csc")
    count = rows.shape[1]
    return sp.csr_matrix(stacked[:, np.arange(3 * count).reshape(3, count).T.ravel()])


def _kept(along: sp.csr_matrix, controls: Array, lengths: Array) -> tuple[sp.csr_matrix, Array]:
    now = along @ controls
    long = np.linalg.norm(now, axis=1)
    weight = 1 / (_STRAIN * lengths)
    rows = sp.diags(weight) @ _projected(along, now / long[:, None])
    return sp.csr_matrix(rows), weight * (lengths - long)


def _towards(goal: Array, rows: sp.csr_matrix, controls: Array, scale: float) -> tuple[sp.csr_matrix, Array]:
    """Return the rows that bring `rows @ controls` to a goal (k, 3), to about a scale."""
    return sp.csr_matrix(sp.kron(rows, sp.identity(3)) / scale), ((goal - rows @ controls) / scale).ravel()


def _solve(blocks: list[tuple[sp.csr_matrix, Array]], size: int) -> Array:
    """Return the least-squares step of all blocks (rows, wanted change)."""
    normal, right = np.zeros((size, size)), np.zeros(size)
    for rows, wanted in blocks:
        normal += (rows.T @ rows).toarray()
        right += rows.T @ wanted
    return np.asarray(np.linalg.solve(normal + 1e-9 * np.trace(normal) / size * np.eye(size), right))
