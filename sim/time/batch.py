"""Sizes of a batch."""

from dataclasses import dataclass

from sim.design.support import Support
from sim.forces.added import AddedForce
from sim.forces.contact_pairs import Touching


@dataclass(frozen=True)
class Batch:
    """Sizes of the batch that lies in the fields."""

    blocks: int
    nu: int
    nv: int
    points: int  # fixed points, the most of any lane; 0 without muscles
    support: Support
    smoothing: int  # nodes over which the preconditioner's frames are averaged, to each side
    touching: Touching | None = None  # with self_contact
    added: tuple[AddedForce, ...] = ()  # forces of effects

    @property
    def grid(self) -> tuple[int, int, int]:
        return self.blocks, self.nu, self.nv
