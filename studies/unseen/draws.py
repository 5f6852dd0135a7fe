"""Cases of models drawn jointly, with what a model cannot know of a muscle type that it never saw."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import MUSCLE_TYPES, OF_MUSCLES, Case
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import Ensemble
from fabdesign.nouns.pressure import PressureProgram
from optimize.fit.parameters import PRIOR

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Draws:
    """Independent standard normals z stand for a model: first its covariance's, then, for each number of a muscle type
    that the model does not have, the data sheet's prior."""

    model: Model
    design: Design

    @cached_property
    def unknown(self) -> tuple[str, ...]:
        """Factors of the design's muscle types that the model says nothing of."""
        known = self.model.factors
        types = dict.fromkeys(muscle.type for muscle in self.design.muscles)
        names = [(f"{MUSCLE_TYPES}{kind}.{own}", own) for kind in types for own in OF_MUSCLES]
        return tuple(name for name, own in names if name not in known and own not in known)

    @property
    def names(self) -> tuple[str, ...]:
        return (*self._ensemble.names, *self.unknown)

    @cached_property
    def _ensemble(self) -> Ensemble:
        return Ensemble(self.model)

    def case(self, z: Array, program: PressureProgram, design: Design | None = None) -> Case:
        """Of (n,) z; on the design, or on another one."""
        count = self._ensemble.size
        model = self._ensemble.at(z[:count])
        own = {
            name: float(np.exp(PRIOR[name.rpartition(".")[2]] * x))
            for name, x in zip(self.unknown, z[count:], strict=True)
        }
        return Case(design or self.design, program, model.factors | own, model.terms)
