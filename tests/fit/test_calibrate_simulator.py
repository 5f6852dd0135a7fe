"""Calibration against clouds of the simulator itself, whose shapes hardly tell the factors apart."""

import numpy as np

from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import PARAMETERS
from fabdesign.nouns.pressure import PressureProgram
from sim import Simulator
from studies.calibration.calibrate import CalibrationOptions
from studies.calibration.calibrate import calibrate_sets as calibrate
from tests.simulated_set import simulated_set

TRUTH = dict(zip(PARAMETERS, np.exp([0.14, -0.02, -0.16, 0.06, -0.2, -0.05, 0.01]), strict=True))
TIMES = np.arange(1, 11) * 0.05  # s


def test_the_truth_comes_back(tmp_path):
    # *side* hardly bends: all stiffnesses, the density, gain and offset 14, 5 and 10 % higher move it by 0.07 mm
    design, rng, forward = build("side"), np.random.default_rng(1), Simulator(points_per_side=21)
    noise = SensorNoise(0.0006, 0.003, 0.05)
    programs = [
        PressureProgram(np.array([0.0, 0.2]), rng.uniform(0, 400e3, (2, design.channels)), 0.5) for _ in range(4)
    ]
    measured = simulated_set(
        tmp_path / "set", forward, design, programs, TIMES, noise=noise, points=1000, rng=rng, factors=TRUTH
    )
    fit = calibrate(measured, forward, options=CalibrationOptions(engines=np.zeros(7))).fit
    error = fit.x - np.log([TRUTH[name] for name in PARAMETERS])
    assert fit.converged
    assert (np.abs(error) < 3 * np.sqrt(np.diag(fit.covariance)) + 0.01).all()
    assert np.abs(error).max() < 0.08
