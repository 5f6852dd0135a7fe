"""How sure a motion is: the program with other pressures and models, and where a small change leads to another side."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import drawn, joint_root
from fabdesign.nouns.pressure import PressureProgram, limits
from fabdesign.study_files.follow_file import Scatter
from studies.prediction.forward_model import forward_model

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]
SNAPPED = 3e-3  # m, RMS over the cloth by which a copy is off after a snap
ALONE = 4.0  # times as far off as the median copy


@dataclass(frozen=True, eq=False)
class Copies:
    """Motions (copies, K, 2 n, 3) m beside the one that is meant (K, 2 n, 3) m. times (K,) s."""

    times: Array
    meant: Floats
    motions: Floats

    @property
    def off(self) -> Array:
        """(copies, K) m, RMS over the cloth."""
        return np.asarray(np.sqrt(np.square(self.motions - self.meant).sum(axis=-1).mean(axis=-1)))

    @property
    def band(self) -> Array:
        """(K,) m: half of the 90 % interval, RMS over the cloth."""
        return np.asarray(1.645 * np.sqrt(np.square(self.off).mean(axis=0)))

    @property
    def snap(self) -> float | None:
        """s, from when on a copy that differs by little moves elsewhere; None where none does."""
        off = self.off
        far = (off > SNAPPED) & (off > ALONE * np.median(off, axis=0))
        return float(self.times[int(np.argmax(far.any(axis=0)))]) if far.any() else None


def copies_of(
    simulator: ForwardModel, model: Model | None, case: Case, times: Array, scatter: Scatter, seed: int
) -> Copies | None:
    """Return the case's motion beside copies: each with pressures off by the channel, and a model of the covariance
    where there is one. Copies that diverge are none. None where there is none."""
    if not scatter.copies:
        return None
    rng = np.random.default_rng(seed)
    gains = 1 + scatter.pressure * rng.standard_normal((scatter.copies, case.program.pressure.shape[1]))
    cases = [replace(case, program=_scaled(case.program, row, limits(case.design))) for row in gains]
    models = _models(model, scatter.copies, rng)
    if models is None:
        motions = forward_model(simulator, model).motions([case, *cases], [times] * (scatter.copies + 1))
    else:
        [first] = forward_model(simulator, model).motions([case], [times])
        motions = [first]
        for one, own in zip(models, cases, strict=True):
            motions += forward_model(simulator, one).motions([own], [times])
    meant, sound = motions[0], [own for own in motions[1:] if np.isfinite(own).all()]
    return Copies(times, meant, np.array(sound)) if sound and np.isfinite(meant).all() else None


def _models(model: Model | None, count: int, rng: np.random.Generator) -> Sequence[Model] | None:
    if model is None or model.covariance is None:
        return None
    root = joint_root(model)
    return [drawn(model, root, rng.standard_normal(len(root))) for _ in range(count)]


def _scaled(program: PressureProgram, gains: Array, most: Array) -> PressureProgram:
    return PressureProgram(program.time, np.clip(program.pressure * gains, 0.0, most), program.duration)
