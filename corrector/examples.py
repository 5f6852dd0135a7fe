"""What the field network learns from: frames of trials, each with its inputs and what was measured there."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corrector.inputs import HISTORY, Layout, inputs_of
from corrector.matching import offsets
from corrector.shape import FINE, Frames, middle_of, refine
from fabdesign.corrector import with_history
from fabdesign.fabric import Fabric
from fabdesign.forward import Case
from fabdesign.output import whole_file

Floats = NDArray[np.float32]
_MOST = 8.0  # points, more of which do not make an offset weigh more: its error is the model's then


@dataclass(frozen=True, eq=False)
class Examples:
    """Frames of one trial or of many in a row. float32."""

    inputs: Floats  # (B, CHANNELS, n, n)
    middle: Floats  # (B, side, side, 3) m, simulated mid-surface
    across: Floats  # (B, FINE, FINE, 3), and `down`, `normal`: its frames (shape.Frames)
    down: Floats
    normal: Floats
    along: Floats  # (B, FINE, FINE, 3) the normals of the surface that the clouds were matched to
    goal: Floats  # (B, FINE, FINE) m: what the displacement along `along` is to be
    weight: Floats  # (B, FINE, FINE)

    @staticmethod
    def of(
        case: Case, layout: Layout, times: NDArray[np.float64], motion: NDArray[np.floating], clouds: Sequence
    ) -> "Examples":
        """One trial's frames at `times` (B,) s. motion: (U, 2 side^2, 3) m at `with_history(times, HISTORY)`; clouds:
        B of (n, 3) m."""
        _, where = with_history(times, HISTORY)
        fabric = case.design.fabric
        inputs = inputs_of(case, layout, times, motion[where])
        middle = middle_of(motion[where[0]], round((motion.shape[1] // 2) ** 0.5)).astype(np.float32)
        frames = Frames.of(middle, fabric.width, fabric.height, FINE)
        goal, weight = _matched(middle, clouds, fabric.thickness)
        return Examples(inputs, middle, frames.across, frames.down, frames.normal, frames.normal, goal, weight)

    def rematched(self, displacement: Floats, clouds: Sequence, fabric: Fabric) -> "Examples":
        """The same with the clouds matched to the mid-surfaces moved by `displacement` (B, FINE, FINE, 3) m."""
        moved = self.middle + refine(displacement, self.middle.shape[1])
        along = Frames.of(moved, fabric.width, fabric.height, FINE).normal
        goal, weight = _matched(moved, clouds, fabric.thickness)
        goal = goal + np.einsum("...i,...i->...", along, displacement)
        return replace(self, along=along.astype(np.float32), goal=goal.astype(np.float32), weight=weight)

    def __len__(self) -> int:
        return len(self.inputs)

    def rows(self, rows: NDArray[np.intp] | slice) -> "Examples":
        return Examples(*(getattr(self, field.name)[rows] for field in fields(self)))

    @staticmethod
    def joined(parts: Sequence["Examples"]) -> "Examples":
        return Examples(*(np.concatenate([getattr(p, field.name) for p in parts]) for field in fields(Examples)))

    def save(self, path: Path) -> None:
        with whole_file(path) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **{field.name: getattr(self, field.name) for field in fields(self)})

    @staticmethod
    def load(path: Path) -> "Examples":
        with np.load(path) as arrays:
            found: Mapping[str, Floats] = {field.name: arrays[field.name] for field in fields(Examples)}
        return Examples(**found)


def _matched(middle: NDArray[Any], clouds: Sequence, thickness: float) -> tuple[Floats, Floats]:
    pairs = [offsets(frame, cloud, thickness) for frame, cloud in zip(middle, clouds, strict=True)]
    goal, count = (np.array(x, dtype=np.float32) for x in zip(*pairs, strict=True))
    return goal, np.minimum(count, _MOST)
