"""The field corrector: a displacement of the ordered points, in numpy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corrector.basis import Basis
from corrector.designs import described, distance
from corrector.inputs import HISTORY, MuscleFields, fields_of
from corrector.outputs import displacement_of
from corrector.response import weight_over_stiffness
from corrector.shape import FINE, LocalFrames, displaced, middle_of
from fabdesign.nouns.corrector import Trust, with_history
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case

Floats = NDArray[np.floating[Any]]
NEAR = 0.2  # distance over which a design stops being one of those learned from


@dataclass(frozen=True, eq=False)
class FieldCorrector:
    """Implements fabdesign.nouns.corrector.Corrector. `known`: the designs it learned from (`designs.described`)."""

    seen: NDArray[np.float64]  # (K,) coefficients of the basis functions, for layouts learned from
    unseen: NDArray[np.float64]  # (K,) for others
    known: Sequence[Mapping[str, Any]]
    limit: float  # of trust
    ordered: bool = True
    starts: float = 0.0
    _layouts: dict[int, tuple[Design, MuscleFields, Trust]] = field(
        default_factory=dict
    )  # by the design's id, which it keeps

    def history(self) -> tuple[float, ...]:
        return HISTORY

    def trust(self, design: Design) -> Trust:
        return Trust(distance(described(design), self.known), self.limit)

    def correct(
        self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]], motions: Sequence[Floats]
    ) -> list[NDArray[np.float32]]:
        """See fabdesign.nouns.corrector.Corrector."""
        return [self._correct(*one) for one in zip(cases, times, motions, strict=True)]

    def _correct(self, case: Case, times: NDArray[np.float64], motion: Floats) -> NDArray[np.float32]:
        _, where = with_history(times, HISTORY)
        _, trust = self._known(case.design)
        answer = np.array(motion[where[0]], dtype=np.float32)
        sound = np.isfinite(motion[where]).all(axis=(0, 2, 3))
        if trust.applies and sound.any():
            moved = self.displacement(case, times[sound], motion[where[:, sound]])
            answer[sound] = displaced(answer[sound], moved, case.design.fabric.thickness)
        return answer

    def displacement(self, case: Case, times: NDArray[np.float64], motion: Floats) -> NDArray[np.float32]:
        """Return (T, FINE, FINE, 3) m of the mid-surface. motion: as `inputs.fields_of` takes it."""
        fabric = case.design.fabric
        layout, trust = self._known(case.design)
        combination = Basis.of(fields_of(case, layout, times, motion)).combined(self.coefficients(trust.distance))
        middle = middle_of(motion[0], round((motion.shape[2] // 2) ** 0.5)).astype(np.float32)
        frames = LocalFrames.of(middle, fabric.width, fabric.height, FINE)
        return displacement_of(combination, frames, fabric, weight_over_stiffness(case))

    def coefficients(self, distance: float) -> NDArray[np.float64]:
        """Return (K,) for a design so far from those learned from."""
        nearness = max(1 - distance / NEAR, 0.0)
        return nearness * self.seen + (1 - nearness) * self.unseen

    def _known(self, design: Design) -> tuple[MuscleFields, Trust]:
        """Return what is the same in all motions of a design, worked out once."""
        if id(design) not in self._layouts:
            if len(self._layouts) > 64:  # a search asks for thousands of designs
                self._layouts.clear()
            self._layouts[id(design)] = (design, MuscleFields.of(design), self.trust(design))
        _, layout, trust = self._layouts[id(design)]
        return layout, trust
