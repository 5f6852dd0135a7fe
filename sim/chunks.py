"""Which cases lie in the fields together, and what they put there."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from fabdesign.effects.acting import active, specimen_of, terms_of
from fabdesign.effects.registry import EFFECTS, force_of
from fabdesign.effects.specimen import Specimen
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.forward import Case
from sim.design.loading import contents_of
from sim.design.support import Support
from sim.equilibrium import damped, is_free, swings_to_rest
from sim.forces.added import AddedForce
from sim.forces.contact_pairs import Touching
from sim.kernels.transfer import Contents
from sim.time.batch import Batch
from sim.time.packing import BLOCKS, pack

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


def laid(chunk: Chunk, n: int, self_contact: bool) -> tuple[Batch, Contents]:
    """Return the chunk on n x n grids."""
    first = chunk.cases[0]
    support = Support.of(first.design.fabric)
    contents = contents_of(chunk.lanes, n, support=support, blocks=BLOCKS)
    touching = Touching(chunk.cases, chunk.packed, n) if self_contact else None
    added = _added_forces() if has_added_force(first) else ()
    smoothing = _smoothing(first.design.fabric, n)
    return Batch(contents.blocks, n, n, contents.points, support, smoothing, touching, added), contents


def has_added_force(case: Case) -> bool:
    return any(effect.force is not None for effect, _, _ in active(case))


def _smoothing(fabric: Fabric, n: int) -> int:
    """Return the smoothing in nodes."""
    return max(1, round(SMOOTHING * (n - 1) / fabric.height))


def _added_forces() -> tuple[AddedForce, ...]:
    """Return the added forces of all effects: one kernel serves them all, and values make them zero."""
    return tuple(dict.fromkeys(force_of(effect) for effect in EFFECTS.values() if effect.force is not None))
