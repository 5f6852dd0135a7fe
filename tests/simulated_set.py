"""Measurement sets of a forward model's own motions, with a sensor's noise."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fabdesign.files.measurement_set import MeasurementSet, NewTrial, TrialData, read_set, write_set
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, ForwardModel, Term
from fabdesign.nouns.pressure import PressureProgram


def simulated_set(
    folder: Path, forward: ForwardModel, design: Design, programs: Sequence[PressureProgram], times: np.ndarray, *,
    noise: SensorNoise, points: int, rng: np.random.Generator, factors: Mapping[str, float] | None = None,
    effects: tuple[Term, ...] = (),
) -> MeasurementSet:  # fmt: skip
    """One trial of role fit a program; `points` of a frame."""
    motions = forward.motions([Case(design, p, factors or {}, effects) for p in programs], [times] * len(programs))
    trials = [
        NewTrial(
            f"{k:03d}", design.name, k, "fit",
            TrialData(times, p.at(times - 1e-6), tuple(noise.draw(Surface.of_faces(f), points, rng) for f in motion)),
        )
        for k, (p, motion) in enumerate(zip(programs, motions, strict=True))
    ]  # fmt: skip
    write_set(folder, {design.name: design}, trials, name="own", description="synthetic")
    return read_set(folder)
