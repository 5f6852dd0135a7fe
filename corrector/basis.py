"""Basis functions of what a simulator leaves out: fields of curvature and strain that the cloth would like to have
on top of its own, from what is there at the place itself, and a few motions of the whole.

These are the basis functions of the field corrector. Each has one coefficient, which is learned
(`corrector.regression`) and the same in every layout. A muscle's tensor (uu, vv, uv) may act along its direction and
across it. A front and a back muscle bend the cloth in opposite directions and strain it alike. Some functions break
this symmetry (a cloth with a curl of its own).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from corrector.inputs import MUSCLE, Fields
from fabdesign.nouns.array import Array

Named = tuple[str, Array, bool]

STRAIN = 0.01  # strain of a unit coefficient; units of the others are 1/m (curvature), rad (swings), m (displacements)
_ONLY_ONE_SIDED = 9  # the first of `MUSCLE`, whose front and back may differ
_TENSION, _PRESSURE = MUSCLE.index("tension"), MUSCLE.index("pressure")
_COMPONENTS = ("uu", "vv", "uv")


@dataclass(frozen=True, eq=False)
class Basis:
    """T frames; the order of `names` is curvature, strain, straight swings, twisting swings, displacements."""

    names: tuple[str, ...]
    anywhere: NDArray[np.bool_]  # (K,) whether it is taken for layouts that were not learned from
    curvature: Array  # (T, C, 3, n, n) 1/m: uu, vv, uv
    strain: Array  # (T, S, 3, n, n): along u, along v, shear
    swings: Array  # (T, W) rad about the hung edge; each also with two sides in opposite directions
    displacements: Array  # (T, D, n, n) m along the normal

    @staticmethod
    def of(fields: Fields) -> "Basis":
        curvature, strain = [*_curvatures(fields)], [*_strains(fields)]
        swings, displacements = [*_swings(fields)], [*_displacements(fields)]
        twisting = [(f"{name}, twisting", value, anywhere) for name, value, anywhere in swings]
        every = [*curvature, *strain, *swings, *twisting, *displacements]
        return Basis(
            tuple(name for name, _, _ in every),
            np.array([anywhere for _, _, anywhere in every]),
            *(np.stack([value for _, value, _ in part], axis=1) for part in (curvature, strain, swings, displacements)),
        )

    def combined(self, coefficients: Array) -> "Combination":
        """Return the sum of all, each times its coefficient (K,)."""
        parts = self.curvature, self.strain, self.swings, self.swings, self.displacements
        ends = np.cumsum([part.shape[1] for part in parts])
        curvature, strain, straight, twisting, displacements = np.split(coefficients, ends[:-1])
        return Combination(
            np.einsum("tkcij,k->tcij", self.curvature, curvature),
            STRAIN * np.einsum("tkcij,k->tcij", self.strain, strain),
            np.stack([self.swings @ straight, self.swings @ twisting], axis=1),
            np.einsum("tkij,k->tij", self.displacements, displacements),
        )


@lru_cache(maxsize=1)
def _any() -> Basis:
    tensor, one = np.zeros((1, 3, 1, 1)), np.zeros(1)
    pair = np.zeros((2, 1))
    return Basis.of(
        Fields(
            np.zeros((1, 2, len(MUSCLE), 3, 1, 1)),
            tensor,
            tensor,
            np.zeros((2, 1, 3, 1, 1)),
            np.zeros((3, 1, 1, 1)),
            one,
            one,
            pair,
        )
    )


def names() -> tuple[str, ...]:
    """Return (K,) of all basis functions."""
    return _any().names


def least_effects() -> Array:
    """Return (K,) share of an error that a unit coefficient counts as at least (`regression.coefficients_of`): a strain
    of 1 % as all of it."""
    return np.array([1.0 if name.startswith("strain") else 0.05 for name in names()])


def anywhere() -> NDArray[np.bool_]:
    """Return (K,) whether a basis function is taken for layouts that were not learned from."""
    return _any().anywhere


@dataclass(frozen=True, eq=False)
class Combination:
    """The sum of what acts: as in `Basis`, without the axis over functions; swings (T, 2), straight and twisting."""

    curvature: Array
    strain: Array
    swings: Array
    displacements: Array


def _across(tensor: Array) -> Array:
    """Return (..., 3, n, n) of what acts across the direction of (..., 3, n, n)."""
    return np.asarray(tensor[..., [1, 0, 2], :, :] * np.array([1, 1, -1])[:, None, None])


def _along_and_across(name: str, tensor: Array, anywhere: bool) -> Iterator[Named]:
    yield name, tensor, anywhere
    yield f"{name}, across", _across(tensor), anywhere


def _constants(fields: Fields, count: int) -> Iterator[tuple[str, Array]]:
    for c in range(count):
        one = np.zeros_like(fields.curvature)
        one[:, c] = 1
        yield _COMPONENTS[c], one


def _curvatures(fields: Fields) -> Iterator[Named]:
    front, back = fields.muscles[:, 0], fields.muscles[:, 1]
    bending, both, fade = front - back, front + back, fields.since[1][:, None, None, None]
    for name, one in _constants(fields, 3):
        yield f"curl {name}", one, True
        yield f"curl {name}, fading", fade * one, False
    for k, kind in enumerate(MUSCLE):
        yield from _along_and_across(f"bending: {kind}", bending[:, k], True)
    for k, kind in enumerate(MUSCLE[:_ONLY_ONE_SIDED]):
        yield from _along_and_across(f"bending of one side: {kind}", both[:, k], False)
    yield from _along_and_across("curvature", fields.curvature, True)
    for change, span in zip(fields.changes, ("0.1", "0.3"), strict=True):
        yield from _along_and_across(f"curvature since {span} s", change, False)
    for k, kind in enumerate(MUSCLE[: _PRESSURE + 1]):
        yield f"curvature times {kind}", both[:, k] * fields.curvature, True
        yield f"curvature times {kind}, across", _across(both[:, k]) * fields.curvature, True
    for k in (_TENSION, _PRESSURE):
        for what, value in (("all pressure", fields.total), ("open channels", fields.opened)):
            yield f"bending: {MUSCLE[k]} times {what}", bending[:, k] * value[:, None, None, None], True


def _strains(fields: Fields) -> Iterator[Named]:
    both = fields.muscles.sum(axis=1)
    for k, kind in enumerate(MUSCLE):
        yield from _along_and_across(f"strain: {kind}", both[:, k], True)
    yield from _along_and_across("strain", fields.strain, True)
    for name, one in _constants(fields, 2):
        yield f"strain {name}", one, True


def _swings(fields: Fields) -> Iterator[Named]:
    bending = (fields.muscles[:, 0] - fields.muscles[:, 1]).mean(axis=(-2, -1))  # (T, kinds, 3)
    yield "swing", np.ones(len(bending)), True
    for value, span in zip(fields.since, ("0.1", "0.4"), strict=True):
        yield f"swing, fading in {span} s", value, False
    for speed, span in zip(fields.speeds, ("1/30", "0.1", "0.3"), strict=True):
        yield f"swing by the speed over {span} s", speed.mean(axis=(1, 2)), False
    for c in range(2):
        yield f"swing by curvature {_COMPONENTS[c]}", fields.curvature[:, c].mean(axis=(1, 2)), False
        for k, kind in enumerate(MUSCLE[:_ONLY_ONE_SIDED]):
            yield f"swing by {kind} {_COMPONENTS[c]}", bending[:, k, c], False


def _displacements(fields: Fields) -> Iterator[Named]:
    for speed, span in zip(fields.speeds, ("1/30", "0.1", "0.3"), strict=True):
        yield f"speed over {span} s", speed, False
