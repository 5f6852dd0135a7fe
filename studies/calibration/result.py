"""The result of a calibration, as `calibrate --json` prints it."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fabdesign.formats.json_file import plain
from fabdesign.formats.result_tables import OfModel
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.nouns.model import Model
from fabdesign.units import in_mm
from optimize.fit.fitted import Fit
from studies.fitting.intervals import excess
from studies.intervals.calibrate import spread_json
from studies.measured.fit_data import MeasuredData
from studies.measured.used_frames import UsedFrames


@dataclass(frozen=True, eq=False)
class Calibration(OfModel):
    """The result of a fit to measurement sets."""

    model: Model
    fit: Fit
    correlation: np.ndarray  # (p, p), of the unknowns in the order of fit.vector
    statements: tuple[str, ...]  # what these data do not determine
    warnings: tuple[str, ...]  # why the intervals are not reliable
    skipped: tuple[str, ...]  # bad trials left out, a line each
    data: MeasuredData
    intervals: str | None = None  # how good those of motions are; None: not asked for

    @property
    def used(self) -> UsedFrames:
        """Frames that took part: not those of sensitive stretches."""
        return self.data.used

    @property
    def noise(self) -> SensorNoise:
        return self.data.noise

    def as_json(self) -> dict[str, Any]:
        """Return what `calibrate --json` prints: factors, mm."""
        parameters = {
            name: {"factor": p.factor, "interval90": p.interval90, "believable": p.reliable}
            for name, p in self.model.parameters.items()
        }
        names = self.fit.vector.names
        content = {
            "parameters": parameters,
            "effects": self.model.effects,
            "correlation": {
                a: dict(zip(names, row, strict=True)) for a, row in zip(names, self.correlation, strict=True)
            },
            "statements": self.statements,
            "believable": not self.warnings,
            "doubts": self.warnings,
            "residual": {"before": in_mm(self.fit.before), "after": in_mm(self.fit.after), "unit": "mm"},
            "excess": {"after": in_mm(excess(self.fit.after, self.noise)), "unit": "mm"},
            "noise": {"sigma": in_mm(self.noise.sigma), "strays": self.noise.strays, "unit": "mm"},
            "fitted": self.model.provenance.fitted,
            "held_out": self.model.provenance.held_out,
            "outlying": self.fit.outlying,
            "lost": [{"trial": trial, "from_s": time} for trial, time in self.fit.lost],
            "skipped": self.skipped,
            "input_accuracy": self.data.accuracy,
            "spread": spread_json(self.model),
            **self.used.as_json(),
            "iterations": self.fit.iterations,
            "converged": self.fit.converged,
            "interrupted": self.fit.interrupted,
        }
        return dict(plain(content))
