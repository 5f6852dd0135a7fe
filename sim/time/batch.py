"""The batch that lies in the fields."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.design.support import Support
from sim.forces.added import AddedForce
from sim.forces.contact_pairs import Touching
from sim.kernels.fields import LANES
from sim.kernels.transfer import read, read_states


@dataclass(frozen=True)
class Batch:
    """Its sizes, and what of it is read back."""

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

    def positions(self, plane: int) -> NDArray[np.float32]:
        """Return (lanes, n, n, 3) m, in a plane of F.node3."""
        out = np.empty((self.blocks, LANES, self.nu * self.nv, 3), np.float32)
        read(*self.grid, plane, out)
        return out.reshape(-1, self.nv, self.nu, 3)

    def states(self) -> NDArray[np.float32]:
        """Return (lanes, points, 2): contraction and tension [N] of every interval as last evaluated."""
        out = np.zeros((self.blocks, LANES, max(self.points, 1), 2), np.float32)
        read_states(self.blocks, self.points, out)
        return out[:, :, : self.points].reshape(self.blocks * LANES, self.points, 2)
