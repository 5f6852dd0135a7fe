"""Which cases lie in the fields together, in which lanes, and what they put there."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TypeVar

import numpy as np

from fabdesign.effects.acting import active, specimen_of, terms_of
from fabdesign.effects.declaration import Specimen
from fabdesign.effects.registry import EFFECTS, force_of
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import Case
from sim.equilibrium import damped, is_free, swings_to_rest
from sim.forces.added import AddedForce
from sim.forces.contact import Touching
from sim.grid import Support
from sim.kernels.fields import LANES
from sim.loading import load
from sim.schedule import Batch

Result = TypeVar("Result")

BLOCKS = 8  # of LANES designs in the fields at once


def pack(patterns: Sequence[tuple]) -> list[list[int]]:
    """Return blocks of LANES indices each, of cases whose steps are of the `patterns` (sortable): those alike together,
    for a block takes as many steps as the lane with the most, and factors whenever one of them changes; spare lanes
    repeat the last case. Unlike cases ride beside their neighbours in order, in so many blocks that all threads have
    work."""
    order = sorted(range(len(patterns)), key=lambda i: (patterns[i], i))
    groups = [list(group) for _, group in groupby(order, key=lambda i: patterns[i])]
    blocks = [group[k : k + LANES] for group in groups for k in range(0, len(group) - LANES + 1, LANES)]
    remainders = [group[len(group) // LANES * LANES :] for group in groups]
    rest = [i for group in remainders for i in group]
    if rest:
        count = -(-len(rest) // LANES)
        if sum(map(bool, remainders)) > 1:
            threads = os.cpu_count() or 1
            count = min(count + -(len(blocks) + count) % threads, len(rest))
        blocks += [part.tolist() for part in np.array_split(rest, count)]
    return [block + block[-1:] * (LANES - len(block)) for block in blocks]


SMOOTHING = 0.020  # m, half width over which the preconditioner's frames are averaged


@dataclass(frozen=True, eq=False)
class Chunk:
    """Cases that one call of a kernel takes."""

    places: list[int]  # of each among the cases asked for
    cases: list[Case]
    packed: list[int]  # which of these rides in each lane

    @property
    def lanes(self) -> list[Case]:
        return [self.cases[i] for i in self.packed]

    @property
    def channels(self) -> int:
        return max(1, *(case.program.pressure.shape[1] for case in self.cases))

    def unpacked(self, lanes: Sequence[Result]) -> Iterator[tuple[int, Result]]:
        """Yield the result of each case, of those of all lanes, with its place among the cases asked for."""
        for k, place in enumerate(self.places):
            yield place, lanes[self.packed.index(k)]

    def damped(self) -> "Chunk":
        """Return the chunk with so much air damping that they come to rest soon."""
        return replace(self, cases=[damped(case) for case in self.cases])


def chunks_of(cases: Sequence[Case], n: int, patterns: Mapping[int, tuple] | None = None) -> list[Chunk]:
    """Return cases on n x n grids: held alike, so that a design's result does not depend on its neighbours, and at most
    BLOCKS blocks. patterns: of the steps of those that are asked for, which ride together where these are alike; None:
    all."""
    patterns = dict.fromkeys(range(len(cases)), ()) if patterns is None else patterns
    groups: dict[tuple[Support, bool, bool, int, bool], list[int]] = {}
    for i in patterns:
        case = cases[i]
        specimen = specimen_of(case) if terms_of(case) else Specimen(case.design, {})
        fabric = specimen.design.fabric
        start = is_free(fabric), swings_to_rest(specimen)
        alike = Support.of(fabric), *start, _smoothing(fabric, n), has_added_force(case)
        groups.setdefault(alike, []).append(i)
    chunks = []
    for group in groups.values():
        blocks = pack([patterns[i] for i in group])
        for k in range(0, len(blocks), BLOCKS):
            lanes = [i for block in blocks[k : k + BLOCKS] for i in block]
            distinct = list(dict.fromkeys(lanes))
            places = [group[i] for i in distinct]
            chunks.append(Chunk(places, [cases[i] for i in places], [distinct.index(i) for i in lanes]))
    return chunks


def laid(chunk: Chunk, n: int, self_contact: bool) -> Batch:
    """Return the chunk in the fields, on n x n grids."""
    first = chunk.cases[0]
    support = Support.of(first.design.fabric)
    points = load(chunk.lanes, n, support=support, blocks=BLOCKS)
    touching = Touching(chunk.cases, chunk.packed, n) if self_contact else None
    added = every_force() if has_added_force(first) else ()
    smoothing = _smoothing(first.design.fabric, n)
    return Batch(len(chunk.packed) // LANES, n, n, points, support, smoothing, touching, added)


def every_force() -> tuple[AddedForce, ...]:
    """Return the forces of all effects: one kernel serves them all, and what leads; values make them zero."""
    return tuple(dict.fromkeys(force_of(effect) for effect in EFFECTS.values() if effect.force is not None))


def has_added_force(case: Case) -> bool:
    return any(effect.force is not None for effect, _, _ in active(case))


def _smoothing(fabric: Fabric, n: int) -> int:
    """Return the smoothing in nodes."""
    return max(1, round(SMOOTHING * (n - 1) / fabric.height))
