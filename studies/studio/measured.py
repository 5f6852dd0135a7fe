"""A measurement set beside its prediction: one trial at a time, frame by frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.surface import CAP, Surface, capped_rms
from fabdesign.trial import Trial
from fabdesign.trial_file import TrialData


@dataclass(frozen=True, eq=False)
class TrialMotion:
    """Frames (T, 2 n, 3) m at times (T,) s, and with them, where they were measured, the clouds (n_t, 3) m."""

    name: str
    times: NDArray[np.float64]
    points: NDArray[np.float32]
    trial: TrialData | None = None

    def cloud(self, frame: int) -> NDArray[np.float64] | None:
        return None if self.trial is None else np.asarray(self.trial.frames[frame], dtype=np.float64)

    def distances(self, frame: int) -> NDArray[np.float64] | None:
        """(n_t,) m from each measured point to the predicted surface, capped at 10 mm."""
        cloud = self.cloud(frame)
        if cloud is None:
            return None
        return np.minimum(Surface.of_faces(self.points[frame]).distance(cloud, within=CAP), CAP)

    def in_words(self, frame: int) -> str:
        text = f"{self.name}, {self.times[frame]:.3f} s"
        distances = self.distances(frame)
        return text if distances is None else f"{text}: surface RMS {1e3 * capped_rms(distances):.2f} mm"


def labels(trials: tuple[Trial, ...]) -> dict[str, Trial]:
    """A name for each trial in a list of them."""
    return {f"{trial.name} ({trial.design_name}, {trial.role})": trial for trial in trials}
