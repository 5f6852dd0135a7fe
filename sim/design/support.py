"""How a cloth is held: by an edge, at points, or not at all."""

from enum import IntEnum

from fabdesign.nouns.fabric import Fabric


class Support(IntEnum):
    """The kinds of support. Kernels take the number; edges come first."""

    TOP = 0
    BOTTOM = 1
    LEFT = 2
    RIGHT = 3
    NONE = 4
    POINTS = 5

    @classmethod
    def of(cls, fabric: Fabric) -> "Support":
        return cls[fabric.hung.upper()] if isinstance(fabric.hung, str) else cls.POINTS

    @property
    def is_edge(self) -> bool:
        """Whether the preconditioner knows what is held: it does not know single nodes."""
        return self < EDGES

    @property
    def nodes(self) -> tuple[int | slice, int | slice]:
        """Return the rows and columns of a held edge on the grid."""
        every = slice(None)
        return ((0, every), (-1, every), (every, 0), (every, -1))[self]


EDGES = 4  # kinds of support below this are edges
TOP, BOTTOM, LEFT, RIGHT = range(EDGES)  # for kernels
