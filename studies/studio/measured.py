"""A measurement set beside its prediction: one trial at a time, frame by frame, and a table of all of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.metrics import Errors
from fabdesign.geometry.surface import CAP, Surface, capped_rms
from fabdesign.nouns.array import Array
from fabdesign.nouns.model import Model
from fabdesign.nouns.trial import Trial
from fabdesign.units import in_mm
from studies.studio.solver import Ask, Correction

APART = 1e-3  # m: surfaces nearer than that, drawn through each other, only flicker
_SCALED = 8  # frames that the end of a motion's scale is taken from
UNKNOWN = (Errors(*[float("nan")] * 5),)


@dataclass(frozen=True, eq=False)
class TrialMotion:
    """Frames (T, 2 n, 3) m at times (T,) s, and with them, where they were measured or are wanted, the clouds (n_t, 3)
    m. points: corrected where a corrector acts. off: (T,) m from what is wanted, NaN at instants at which nothing
    is: the cloud is then the next one that is."""

    name: str
    times: Array
    points: NDArray[np.float32]
    clouds: Sequence[NDArray[np.floating[Any]]] | None = None
    correction: Correction | None = None
    off: Array | None = None

    @cached_property
    def _moved(self) -> float:
        """Return m, the most by which a corrector moved a point."""
        return 0.0 if self.correction is None else float(self.correction.moved(self.points).max())

    def ghost(self, frame: int) -> NDArray[np.float32] | None:
        """Return a frame (2 n, 3) m before the corrector, where that is far enough off to be seen beside."""
        return None if self.correction is None or self._moved < APART else self.correction.simulated[frame]

    def cloud(self, frame: int) -> Array | None:
        """Return what was measured or is wanted of a frame, (n_t, 3) m."""
        return None if self.clouds is None else np.asarray(self.clouds[frame], dtype=np.float64)

    def distances(self, frame: int, *, corrected: bool = True) -> Array | None:
        """Return (n_t,) m from each of these points to the surface, as it is shown or before the corrector, capped at
        10 mm."""
        if (cloud := self.cloud(frame)) is None:
            return None
        points = self.points if corrected or self.correction is None else self.correction.simulated
        return np.minimum(Surface.of_faces(points[frame]).distance(cloud, within=CAP), CAP)

    @cached_property
    def largest(self) -> float | None:
        """Return the end [m] of the scale of distances: their 98th percentile, in frames spread over the motion."""
        frames = np.unique(np.linspace(0, len(self.times) - 1, _SCALED).astype(int)).tolist()
        of_frames = [distances for frame in frames if (distances := self.distances(frame)) is not None]
        return float(np.percentile(np.concatenate(of_frames), 98)) if of_frames else None

    def in_words(self, frame: int) -> str:
        text = f"{self.name}, {self.times[frame]:.3f} s"
        if self.off is not None:
            error, mean = in_mm(self.off[frame]), in_mm(float(np.nanmean(self.off)))
            now = f"{error:.2f} mm" if np.isfinite(error) else "not wanted at this instant"
            return f"{text}: surface RMS {now}, mean {mean:.2f} mm"
        shown = [
            self.distances(frame, corrected=corrected) for corrected in ((True, False) if self._moved else (True,))
        ]
        rms = [f"{in_mm(capped_rms(distances)):.2f} mm" for distances in shown if distances is not None]
        if not rms:
            return text
        return f"{text}: surface RMS " + " corrected, ".join(rms) + (" without the corrector" if self._moved else "")


def ask_of_trial(trial: Trial, model: Model) -> Ask:
    """Return the ask for a trial's motion as sensors see it, and its errors from what was measured. Raises
    InputError."""
    measured = tuple(trial.load().frames)
    return Ask("motion", trial.design, trial.program, model, trial.times, trial.order, True, measured)


def errors_table(by_trial: Mapping[str, tuple[Errors, ...]]) -> str:
    """Return in Markdown a row for each trial, surface RMS in mm, without and with the corrector where one acts, and
    the noise floor; and the means."""
    if not by_trial:
        return ""
    corrected = any(len(errors) > 1 for errors in by_trial.values())
    rows = {
        name: [e.surface_rms for e in (errors[0], errors[-1])[: 1 + corrected]] + [errors[-1].surface_floor]
        for name, errors in by_trial.items()
    }
    if len(rows) > 1:
        rows[f"**mean of {len(rows)}**"] = np.mean([*rows.values()], axis=0).tolist()
    head = ["trial", "predicted", *(["corrected"] if corrected else []), "noise floor"]
    lines = [head, ["---"] * len(head)]
    for name, values in rows.items():
        lines.append([name, *(f"{in_mm(x):.2f}" if np.isfinite(x) else "not known" for x in values)])
    return "Surface RMS, mm, mean of all frames\n\n" + "\n".join("| " + " | ".join(line) + " |" for line in lines)
