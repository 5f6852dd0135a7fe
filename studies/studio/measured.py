"""A measurement set beside its prediction: one trial at a time, frame by frame, and a table of all of them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.metrics import Errors
from fabdesign.surface import CAP, Surface, capped_rms
from fabdesign.trial import Trial
from fabdesign.trial_file import TrialData
from fabdesign.units import in_mm
from studies.studio.solver import Correction

APART = 1e-3  # m: surfaces nearer than that, drawn through each other, only flicker
_SCALED = 8  # frames that the end of a motion's scale is taken from


@dataclass(frozen=True, eq=False)
class TrialMotion:
    """Frames (T, 2 n, 3) m at times (T,) s, and with them, where they were measured, the clouds (n_t, 3) m. points:
    corrected where a corrector acts."""

    name: str
    times: NDArray[np.float64]
    points: NDArray[np.float32]
    trial: TrialData | None = None
    correction: Correction | None = None

    @property
    def simulated(self) -> NDArray[np.float32] | None:
        """(T, 2 n, 3) m before the corrector; None where none changed it."""
        if self.correction is None or not self.correction.moved(self.points).any():
            return None
        return self.correction.simulated

    def ghost(self, frame: int) -> NDArray[np.float32] | None:
        """(2 n, 3) m, the frame before the corrector, where that is far enough off to be seen beside."""
        if self.correction is None or float(self.correction.moved(self.points).max()) < APART:
            return None
        return self.correction.simulated[frame]

    def cloud(self, frame: int) -> NDArray[np.float64] | None:
        return None if self.trial is None else np.asarray(self.trial.frames[frame], dtype=np.float64)

    def distances(self, frame: int) -> NDArray[np.float64] | None:
        """(n_t,) m from each measured point to the shown surface, capped at 10 mm."""
        return self._distances(self.points, frame)

    def _distances(self, points: NDArray[np.float32], frame: int) -> NDArray[np.float64] | None:
        cloud = self.cloud(frame)
        if cloud is None:
            return None
        return np.minimum(Surface.of_faces(points[frame]).distance(cloud, within=CAP), CAP)

    @cached_property
    def largest(self) -> float | None:
        """m, the end of the scale of distances: their 98th percentile over the motion, in frames spread over it."""
        if self.trial is None:
            return None
        frames = np.unique(np.linspace(0, len(self.times) - 1, _SCALED).astype(int))
        of_frames = [d for d in map(self.distances, frames.tolist()) if d is not None]
        return float(np.percentile(np.concatenate(of_frames), 98))

    def in_words(self, frame: int) -> str:
        text = f"{self.name}, {self.times[frame]:.3f} s"
        distances = self.distances(frame)
        if distances is None:
            return text
        if self.simulated is None:
            return f"{text}: surface RMS {in_mm(capped_rms(distances)):.2f} mm"
        before = self._distances(self.simulated, frame)
        assert before is not None
        return (
            f"{text}: surface RMS {in_mm(capped_rms(distances)):.2f} mm corrected, "
            f"{in_mm(capped_rms(before)):.2f} mm without the corrector"
        )


def labels(trials: tuple[Trial, ...]) -> dict[str, Trial]:
    """A name for each trial in a list of them."""
    return {f"{trial.name} ({trial.design_name}, {trial.role})": trial for trial in trials}


def errors_table(by_trial: dict[str, tuple[Errors, ...]]) -> str:
    """Markdown: a row for each trial, surface RMS in mm, without and with the corrector where one acts, and the noise
    floor; and the means."""
    if not by_trial:
        return ""
    corrected = any(len(errors) > 1 for errors in by_trial.values())
    head = ["trial", "predicted", *(["corrected"] if corrected else []), "noise floor"]
    rows = [head, ["---"] * len(head)]
    values = {
        name: [errors[0].surface_rms, *([errors[-1].surface_rms] if corrected else []), errors[-1].surface_floor]
        for name, errors in by_trial.items()
    }
    rows += [[name, *map(_millimetres, row)] for name, row in values.items()]
    if len(values) > 1:
        rows.append([f"**mean of {len(values)}**", *map(_millimetres, np.mean(list(values.values()), axis=0))])
    return "Surface RMS, mm, mean of all frames\n\n" + "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _millimetres(value: float) -> str:
    return f"{in_mm(value):.2f}" if np.isfinite(value) else "not known"
