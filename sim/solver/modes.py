"""Modes across, in which the flat cloth's own problem falls apart: eigenvectors in one direction of the grid.

Tangential components: of the second difference with free ends; the normal component: of bending with free ends, a free
beam's modes (with those of the second difference, a free edge would be clamped against turning). W weighs an end node
by a half. A side edge may be held.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.design.support import Support

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Modes:
    """Columns of (n, n), orthonormal with respect to W; `odd` of them odd, behind the even ones, or none."""

    tangential: Array
    normal: Array
    odd: int
    stretching: Array  # (n,) eigenvalues of the second difference, tangential
    bending: Array  # (n,) eigenvalues of bending, normal
    slopes: Array  # (n,) what the second difference is of each normal mode


def modes_across(n: int, support: Support) -> Modes:
    keep = slice(1 if support == Support.LEFT else 0, n - 1 if support == Support.RIGHT else n)
    first, second = np.diff(np.eye(n), axis=0), np.diff(np.eye(n), n=2, axis=0)
    stretching, tangential = _eigenvectors(first.T @ first, keep)
    bending, normal = _eigenvectors(second.T @ second, keep)
    odd = n // 2 if keep == slice(0, n) else 0
    return Modes(tangential, normal, odd, stretching, bending, np.square(first @ normal).sum(axis=0))


def modes_down(n: int, support: Support) -> tuple[Array, Array]:
    """Return tangential modes along v (n, n), softest first, and their eigenvalues."""
    turned = {Support.TOP: Support.LEFT, Support.BOTTOM: Support.RIGHT}.get(support, Support.NONE)
    across = modes_across(n, turned)
    order = np.argsort(across.stretching, kind="stable")
    return across.tangential[:, order], across.stretching[order]


def by_four(modes: Modes) -> NDArray[np.float64]:
    """Return (entries, 8): both bases as the transforms read them, half of the rows of the even vectors, of the odd
    ones, and the transposes: rows by four, tangential, then normal."""
    even = len(modes.normal) - modes.odd
    both = []
    for basis in (modes.tangential, modes.normal):
        parts = [basis[:even, :even]]
        if modes.odd:
            parts.append(basis[: modes.odd, even:][::-1])  # their differences lie mirrored
        both.append(np.concatenate([_rows_by_four(part) for part in (*parts, *(part.T for part in parts))]))
    return np.concatenate(both, axis=1)


def _eigenvectors(stiffness: Array, keep: slice) -> tuple[Array, Array]:
    """Return the solutions of K phi = lambda W phi with the nodes outside `keep` held: eigenvalues (n,), columns (n,
    n); zero columns for held nodes come last. Even vectors, then odd ones, where no node is held."""
    n = len(stiffness)
    root = np.ones(n)
    root[[0, -1]] = np.sqrt(0.5)
    free = np.eye(n)[:, keep]
    spaces = [free]
    if free.shape[1] == n:
        half = np.sqrt(0.5) * (free + free[::-1])[:, : n // 2]
        middle = free[:, n // 2 : n - n // 2]
        spaces = [np.hstack([half, middle]), np.sqrt(0.5) * (free - free[::-1])[:, : n // 2]]
    values, columns = [], []
    for space in spaces:
        lam, vectors = np.linalg.eigh(space.T @ (stiffness / np.outer(root, root)) @ space)
        values.append(np.clip(lam, 0, None))
        columns.append(space @ vectors / root[:, None])
    held = n - free.shape[1]
    return np.concatenate([*values, np.full(held, 4.0)]), np.hstack([*columns, np.zeros((n, held))])


def _rows_by_four(matrix: Array) -> Array:
    """Return (n/4 rounded up x n, 4): entry [q n + k, r] is row 4 q + r, column k; rows beyond the last are zero."""
    n = len(matrix)
    padded = np.pad(matrix, ((0, -n % 4), (0, 0)))
    return padded.reshape(-1, 4, n).transpose(0, 2, 1).reshape(-1, 4)
