"""Contact of the cloth with itself: nodes against the cells of other layers, as penalties.

Equations 14-15 of docs/model.md. Which nodes meet which cells, where and from which side, is found between steps
(sim/forces/contact.py); the forces below belong to the positions of the evaluation, so that the step stays
implicit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Case
from sim.kernels.fields import LANES, F, Timed, floats, indices, ints
from sim.kernels.transfer import on_grid
from sim.state import PAIR


@ti.func
def contact(b, nu):
    """f += forces of all pairs; there are none where self_contact is off."""
    for k in indices(F.pairs[b]):
        for lane in indices(LANES):
            if F.pair[b, PAIR * k + 4][lane] > 0:  # a spare entry of this lane has no stiffness
                press(b, nu + 2, k, lane)


@ti.func
def press(b, row, k, lane):
    """The node and the four corners of the cell are pushed apart along the cell's normal; as the energy's whole
    gradient, that of the normal too, these five forces have neither a sum nor a moment."""
    xi = F.pair[b, PAIR * k][lane]
    eta = F.pair[b, PAIR * k + 1][lane]
    side = F.pair[b, PAIR * k + 2][lane]
    i = F.pair_node[b, k][lane]
    c = F.pair_cell[b, k][lane]
    x00, x10 = place(b, c, lane), place(b, c + 1, lane)
    x01, x11 = place(b, c + row, lane), place(b, c + row + 1, lane)
    w10, w01, w11 = xi * (1 - eta), (1 - xi) * eta, xi * eta
    w00 = 1 - w10 - w01 - w11
    apart = place(b, i, lane) - w00 * x00 - w10 * x10 - w01 * x01 - w11 * x11
    along = 0.5 * (x10 - x00 + x11 - x01)
    down = 0.5 * (x01 - x00 + x11 - x10)
    area = down.cross(along)
    size = area.norm() + 1e-12
    n = area / size
    depth = F.pair[b, PAIR * k + 3][lane] - side * n.dot(apart)
    if depth > 0:
        force = F.pair[b, PAIR * k + 4][lane] * depth * side
        push(b, i, lane, force * n)
        # what turning the normal does to the gap: apart . dn = lever . d(down x along)
        lever = 0.5 * force / size * (apart - n.dot(apart) * n)
        p, q = lever.cross(down), along.cross(lever)
        push(b, c, lane, -w00 * force * n - p - q)
        push(b, c + 1, lane, -w10 * force * n + p - q)
        push(b, c + row, lane, -w01 * force * n - p + q)
        push(b, c + row + 1, lane, -w11 * force * n + p + q)


@ti.func
def place(b, k, lane):
    e = F.q + k
    return ti.Vector([F.node3[b, e][lane], F.node3[b, e][LANES + lane], F.node3[b, e][2 * LANES + lane]])


@ti.func
def push(b, k, lane, force):
    for c in ti.static(range(3)):
        F.node3[b, F.f + k][c * LANES + lane] += force[c]


@Timed
@ti.kernel
def put(nb: ti.i32, index: ints(4), value: floats(4)):
    """index (nb, 2, pairs, LANES): node and first corner of the cell, with padding; value (nb, PAIR, pairs, LANES)."""
    for b in range(nb):
        F.pairs[b] = index.shape[2]
        for lane in range(LANES):
            for k in indices(index.shape[2]):
                F.pair_node[b, k][lane] = index[b, 0, k, lane]
                F.pair_cell[b, k][lane] = index[b, 1, k, lane]
                for e in range(PAIR):
                    F.pair[b, PAIR * k + e][lane] = value[b, e, k, lane]


Ints = NDArray[np.int_]
LAYERS = 2  # a node meets the nearest two: one before it, one behind
STIFFNESS = 0.03  # of the membrane's, k / t^2 [N/m^3], of each layer's nodes against the other
LAYER_CELLS, LAYER_THICKNESSES = 3, 3  # along the cloth: nearer is the same layer
SLIP = 0.25  # thicknesses that a node may move before pairs are found anew


# the contact of a node: the cell it meets; where in the cell, 0 ... 1 along u (xi) and v (eta); from which side: 1
# where the node lies on the front of the cell, -1 behind, 0 without a pair; distance [m]
CONTACT = np.dtype([("row", int), ("column", int), ("xi", float), ("eta", float), ("side", float), ("distance", float)])
ContactPairs = NDArray[np.void]  # (n n, LAYERS) of CONTACT


def no_pairs(nodes: int) -> ContactPairs:
    return np.zeros((nodes, LAYERS), CONTACT)


@dataclass(frozen=True)
class ContactSheet:
    """The facts of a design that contact needs."""

    spacing: tuple[float, float]  # m, along u and v
    thickness: float  # m
    stiffness: float  # N/m^3

    @classmethod
    def of(cls, case: Case, n: int) -> "ContactSheet":
        fabric = case.design.fabric
        membrane = case.factors.get("membrane", 1.0) * float(np.sqrt(np.prod(fabric.membrane_stiffness)))
        spacing = fabric.width / (n - 1), fabric.height / (n - 1)
        return cls(spacing, fabric.thickness, STIFFNESS * membrane / fabric.thickness**2)

    @property
    def layer_distance(self) -> float:
        """Return m along the cloth within which nodes belong to the same layer."""
        return max(LAYER_CELLS * max(self.spacing), LAYER_THICKNESSES * self.thickness)


def find(x: Array, sheet: ContactSheet, cutoff: float, before: ContactPairs) -> ContactPairs:
    """Return pairs at most `cutoff` [m] apart in the shape x (n, n, 3). A node that was paired with a cell or its
    neighbours stays on the side where it was then, so that what has slipped through is pushed back."""
    n = len(x)
    node, row, column = _candidates(x, sheet, cutoff)
    p00, p10, p01, p11 = (x[row + j, column + i] for j, i in ((0, 0), (0, 1), (1, 0), (1, 1)))
    a, b = (p10 - p00 + p11 - p01) / 2, (p01 - p00 + p11 - p10) / 2
    position = x.reshape(-1, 3)[node]
    aa, ab, bb = (np.einsum("kc,kc->k", *pair) for pair in ((a, a), (a, b), (b, b)))
    r = position - (p00 + p10 + p01 + p11) / 4
    ra, rb = np.einsum("kc,kc->k", r, a), np.einsum("kc,kc->k", r, b)
    det = np.maximum(aa * bb - ab * ab, 1e-6 * aa * bb)
    xi, eta = 0.5 + (bb * ra - ab * rb) / det, 0.5 + (aa * rb - ab * ra) / det
    # over a ridge between cells a node lies beside both; beyond the cloth's border there is half a thickness of it
    rim = 0.5 * sheet.thickness / np.array(sheet.spacing)
    beside = (
        (xi > np.where(column == 0, -rim[0], -0.5))
        & (xi < 1 + np.where(column == n - 2, rim[0], 0.5))
        & (eta > np.where(row == 0, -rim[1], -0.5))
        & (eta < 1 + np.where(row == n - 2, rim[1], 0.5))
    )
    xi, eta = np.clip(xi, 0, 1), np.clip(eta, 0, 1)
    weights = (1 - xi) * (1 - eta), xi * (1 - eta), (1 - xi) * eta, xi * eta
    r = position - sum(w[:, None] * p for w, p in zip(weights, (p00, p10, p01, p11), strict=True))
    distance = np.linalg.norm(r, axis=1)
    side = np.where(np.einsum("kc,kc->k", r, np.cross(b, a)) < 0, -1.0, 1.0)
    close = np.flatnonzero(beside & (distance < cutoff))
    close = close[np.lexsort((distance[close], node[close]))]
    candidates = np.rec.fromarrays([row, column, xi, eta, side, distance], dtype=CONTACT).view(np.ndarray)
    pairs = no_pairs(n * n)
    for layer in range(LAYERS):
        nodes, first = np.unique(node[close], return_index=True)
        chosen = candidates[close[first]]
        for kept in before[nodes].T:
            same = _close(chosen["row"] - kept["row"], chosen["column"] - kept["column"], sheet)
            chosen["side"] = np.where(same & (kept["side"] != 0), kept["side"], chosen["side"])
        pairs[nodes, layer] = chosen
        met = pairs[node[close], layer]
        close = close[~_close(row[close] - met["row"], column[close] - met["column"], sheet)]
    return pairs


def _candidates(x: Array, sheet: ContactSheet, cutoff: float) -> Ints:
    """Return (3, k): nodes, and rows and columns of cells around the nodes of other layers that are near."""
    from scipy.spatial import cKDTree  # half a second that only contact needs

    n = len(x)
    # from a point above a cell to the nearest corner; cells are stretched by a few per cent
    radius = np.hypot(cutoff, 0.55 * np.hypot(*sheet.spacing))
    pairs = cKDTree(x.reshape(-1, 3)).query_pairs(radius, output_type="ndarray")
    rows, columns = np.divmod(pairs, n)
    pairs = pairs[~_close(rows[:, 0] - rows[:, 1], columns[:, 0] - columns[:, 1], sheet)]
    both = np.concatenate([pairs, pairs[:, ::-1]])
    row, column = np.divmod(both[:, 1], n)
    node, row, column = (
        np.concatenate(a)
        for a in zip(*((both[:, 0], row + j, column + i) for j in (-1, 0) for i in (-1, 0)), strict=True)
    )
    inside = (row >= 0) & (row < n - 1) & (column >= 0) & (column < n - 1)
    once = np.unique(((node * n + row) * n + column)[inside])
    node, cell = np.divmod(once, n * n)
    return np.stack([node, *np.divmod(cell, n)])


def _close(rows: Ints, columns: Ints, sheet: ContactSheet) -> NDArray[np.bool_]:
    """Return whether so many rows and columns apart is the same layer."""
    return np.asarray(np.hypot(columns * sheet.spacing[0], rows * sheet.spacing[1]) <= sheet.layer_distance)


class Touching:
    """The pairs of a batch, found anew for a design when it has moved: each for itself, so that a design's bits do not
    depend on its neighbours. packed: which of the cases rides in each lane."""

    def __init__(self, cases: Sequence[Case], packed: Sequence[int], n: int) -> None:
        self.packed = packed
        self.sheets, self.n = [ContactSheet.of(case, n) for case in cases], n
        self.pairs = [no_pairs(n * n) for _ in cases]
        self.paired_at: list[Array | None] = [None] * len(cases)
        self.last: list[Array | None] = [None] * len(cases)
        self.far = [0.0] * len(cases)  # m, from where on a pair cannot touch before pairs are found anew
        self.h: NDArray[np.floating[Any]] = np.ones(len(cases))  # s, the step that went before

    def refresh(self, blocks: int, h: NDArray[np.floating[Any]]) -> None:
        """Find pairs anew, where they have moved, before a step of h (lanes,) s."""
        n = self.n
        lanes = [self.packed.index(i) for i in range(len(self.sheets))]
        shapes = on_grid(F.node3, (blocks, n, n), F.x0)[lanes].astype(float)
        anew = [
            self._refresh(i, x, float(h[lane] / self.h[i]))
            for i, (lane, x) in enumerate(zip(lanes, shapes, strict=True))
        ]
        if any(anew):
            self._put(blocks)
        self.h = h[lanes]

    def _refresh(self, index: int, x: Array, ratio: float) -> bool:
        """Find the pairs of one design in the shape x (n, n, 3) if it has moved; whether there were or are any.
        ratio: of the step to come to the one before."""
        sheet, last, at = self.sheets[index], self.last[index], self.paired_at[index]
        self.last[index] = x
        if not np.abs(x).max() < 10.0:  # diverged
            anew = bool(self.pairs[index]["side"].any())
            self.pairs[index] = no_pairs(self.n * self.n)
            return anew
        step = 0.0 if last is None else float(np.linalg.norm(x - last, axis=-1).max()) * ratio
        slack = min(sheet.spacing)
        paired = bool(self.pairs[index]["side"].any())
        if at is not None:
            moved = float(np.linalg.norm(x - at, axis=-1).max())
            if moved + (0 if paired else step) < (SLIP * sheet.thickness if paired else slack / 2):
                return False
        cutoff = min(sheet.thickness + max(slack, 2.5 * step), 0.8 * sheet.layer_distance)
        self.pairs[index] = find(x, sheet, cutoff, self.pairs[index])
        self.paired_at[index] = x
        self.far[index] = sheet.thickness + 2 * (SLIP * sheet.thickness + 1.25 * step)
        return paired or bool(self.pairs[index]["side"].any())

    def _put(self, blocks: int) -> None:
        """Put all pairs into the fields."""
        entries = [self._entries(i) for i in range(len(self.sheets))]
        room = max(1, *(index.shape[1] for index, _ in entries))
        index = np.zeros((blocks, 2, room, LANES), np.int32)
        value = np.zeros((blocks, PAIR, room, LANES), np.float32)
        for lane, case in enumerate(self.packed):
            i, v = entries[case]
            index[lane // LANES, :, : i.shape[1], lane % LANES] = i
            value[lane // LANES, :, : i.shape[1], lane % LANES] = v
        put(blocks, index, value)

    def _entries(self, index: int) -> tuple[Ints, Array]:
        """Return (2, pairs) node and cell, with padding; (PAIR, pairs) place in the cell, side, thickness, stiffness
        [N/m]."""
        n, sheet, pairs = self.n, self.sheets[index], self.pairs[index]
        node, layer = np.nonzero((pairs["side"] != 0) & (pairs["distance"] < self.far[index]))
        row, column = np.divmod(node, n)
        half_u, half_v = (np.where((k == 0) | (k == n - 1), 0.5, 1.0) for k in (column, row))
        stiffness = sheet.stiffness * sheet.spacing[0] * sheet.spacing[1] * half_u * half_v
        met = pairs[node, layer]
        nodes = [(j + 1) * (n + 2) + i + 1 for j, i in ((row, column), (met["row"], met["column"]))]
        values = [met["xi"], met["eta"], met["side"], np.full(len(node), sheet.thickness), stiffness]
        return np.stack(nodes), np.stack(values)
