"""Basis functions of what a simulator leaves out: fields of curvature and strain that the cloth would like to have
on top of its own, from what is there at the place itself, and a few motions of the whole.

These are the basis functions of the field corrector. Each has one coefficient, which is learned
(`corrector.field`) and the same in every layout. A muscle's tensor (uu, vv, uv) may act along its direction and
across it. A front and a back muscle bend the cloth in opposite directions and strain it alike. Some functions break
this symmetry (a cloth with a curl of its own).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from corrector.inputs import MUSCLE, Fields
from corrector.shape import (
    FINE,
    NODES,
    LocalFrames,
    put_together,
    refine,
    slopes,
    tangent_changes,
    weight_over_stiffness,
)
from fabdesign.nouns.array import Array, Floats
from fabdesign.nouns.forward import Case

Named = tuple[str, Array, bool]

_STRAIN = 0.01  # strain of a unit coefficient; units of the others are 1/m (curvature), rad (swings), m (displacements)
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

    @property
    def least_effects(self) -> Array:
        """Return (K,) share of an error that a unit coefficient counts as at least (`field.coefficients_of`): a
        strain of 1 % as all of it."""
        return np.array([1.0 if name.startswith("strain") else 0.05 for name in self.names])

    def displacement(self, coefficients: Array, frames: LocalFrames, case: Case) -> NDArray[np.float32]:
        """Return (T, FINE, FINE, 3) m of the mid-surface by all, each times its coefficient (K,). frames: of the
        simulated cloth, at FINE x FINE nodes."""
        parts = self.curvature, self.strain, self.swings, self.swings, self.displacements
        ends = np.cumsum([part.shape[1] for part in parts])
        by_curvature, by_strain, straight, twisting, displacements = np.split(coefficients, ends[:-1])
        fabric = case.design.fabric
        curvature = np.einsum("tkcij,k->tcij", self.curvature, by_curvature).reshape(len(self.swings), -1)
        tilts = (curvature @ slopes(fabric, weight_over_stiffness(case))).reshape(-1, 2, FINE, FINE)
        swing, twist = self.swings @ straight, self.swings @ twisting
        tilts[:, 1] += swing[:, None, None] + twist[:, None, None] * np.linspace(-1, 1, FINE)
        strain = np.moveaxis(_fine(_STRAIN * np.einsum("tkcij,k->tcij", self.strain, by_strain)), 1, -1)
        changes = tangent_changes(np.moveaxis(tilts, 1, -1), strain, frames)
        along = _fine(np.einsum("tkij,k->tij", self.displacements, displacements))[..., None] * frames.normal
        moved = np.array([put_together(*frame, fabric) for frame in zip(*changes, strict=True)])
        return (moved + along).astype(np.float32)

    def heights(self, frames: LocalFrames, case: Case) -> NDArray[np.float32]:
        """Return (T, K, FINE, FINE) m along the normal by a unit coefficient of each, to first order."""
        flat = self.curvature.astype(np.float32).reshape(-1, 3 * NODES**2)
        answer = slopes(case.design.fabric, weight_over_stiffness(case)).astype(np.float32)
        by_curvature = (flat @ answer).reshape(len(self.swings), -1, 2, FINE, FINE)
        straight = np.zeros((*self.swings.shape, 2, FINE, FINE), dtype=np.float32)
        straight[:, :, 1] = self.swings[..., None, None]
        twisting = straight * np.linspace(-1, 1, FINE, dtype=np.float32)
        strain = _fine(_STRAIN * self.strain).astype(np.float32)
        by_strain = np.zeros((*strain.shape[:2], 2, FINE, FINE), np.float32)
        tilts = np.concatenate([by_curvature, by_strain, straight, twisting], 1)
        span = slice(by_curvature.shape[1], by_curvature.shape[1] + strain.shape[1])
        shear = strain[:, :, 2, ..., None] / 2

        def change(k: int) -> Floats:
            size, unit, other = frames.sizes[k], frames.units[k], frames.units[1 - k]
            changes: Floats = tilts[:, :, k, ..., None] * (size * frames.normal)[:, None]
            changes[:, span] = (strain[:, :, k, ..., None] * unit[:, None] + shear * other[:, None]) * size[:, None]
            return changes

        moved = put_together(change(0), change(1), case.design.fabric)
        heights = np.einsum("tkabi,tabi->tkab", moved, frames.normal)
        return np.concatenate([heights, _fine(self.displacements).astype(np.float32)], axis=1)


def _fine(field: Floats) -> Floats:
    """Return (..., FINE, FINE) of (..., n, n)."""
    return refine(field[..., None], FINE)[..., 0]


@lru_cache(maxsize=1)
def every_function() -> Basis:
    """Return all basis functions by name, of a cloth in which nothing is."""
    shapes = (1, 2, len(MUSCLE), 3, 1, 1), (1, 3, 1, 1), (1, 3, 1, 1), (2, 1, 3, 1, 1), (3, 1, 1, 1), 1, 1, (2, 1)
    return Basis.of(Fields(*(np.zeros(shape) for shape in shapes)))


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
