"""The errors of docs/errors.md and the splits."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from sheets import rolled_sheet

from fabdesign.errors import InputError
from fabdesign.geometry.distances import chamfer
from fabdesign.geometry.metrics import (
    Errors,
    beyond_in_words,
    closed,
    statistics,
    surface_rms,
    trial_errors,
)
from fabdesign.geometry.sensor_noise import SensorNoise, estimate_noise
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.pressure import PressureProgram
from studies.measured.splits import fit_trials, folds, split

NOISE = SensorNoise(0.0006, 0.0, 0.0)


def floors(model, count, noise):
    return trial_errors([np.zeros((count, 3))], model[None], noise)


@pytest.mark.parametrize(("count", "stated"), [(3362, 4.26), (1500, 5.05)])
def test_chamfer_floor_is_the_one_that_formats_states(count, stated):
    """mm, at 0.6 mm noise against the grid of 41 x 41 x 2."""
    assert 1e3 * floors(rolled_sheet(), count, NOISE).chamfer_floor == pytest.approx(stated, rel=0.01)


@pytest.mark.parametrize(("error", "stated"), [(1, 4.55), (2, 5.18), (3, 6.23)])
def test_normal_errors_make_the_stated_chamfer(error, stated):
    model, rng = rolled_sheet(), np.random.default_rng(0)
    draws = [NOISE.draw(Surface.of_faces(model), 3362, rng) for _ in range(8)]
    mean_chamfer = np.mean([1e3 * chamfer(drawn, model + [0, 0, error / 1e3]) for drawn in draws])
    assert mean_chamfer == pytest.approx(stated, rel=0.015)


def test_surface_floor_is_the_noise_and_its_strays():
    """Far faces: rms^2 = sigma^2 + strays mean(min(reach x, cap)^2), with x even on 0..1 and the cap at 10 mm."""
    model = rolled_sheet(thickness=0.05)
    assert floors(model, 3362, NOISE).surface_floor == pytest.approx(0.0006, rel=0.01)
    strays = SensorNoise(0.0006, 0.02, 0.012)
    depth = np.minimum(0.012 * np.linspace(0, 1, 1001), 0.010)
    expected = np.sqrt(0.0006**2 * 0.98 + 0.02 * np.mean(depth**2 + 0.0006**2))
    assert floors(model, 3362, strays).surface_floor == pytest.approx(expected, rel=0.03)


def test_surface_rms_of_a_shift_along_the_normal():
    model = rolled_sheet(thickness=0.05)
    inner = np.abs(model[:, 0]) < 0.09
    shifted = (model + [0, 0, 0.003])[inner & (model[:, 1] < -0.01) & (model[:, 1] > -0.19)]
    assert surface_rms(shifted, model) == pytest.approx(0.003, rel=1e-6)


def test_trial_errors_are_means_over_frames():
    rng = np.random.default_rng(0)
    motion = np.stack([rolled_sheet(c) for c in (0.0, 5.0, 10.0)]).astype(np.float32)
    clouds = [NOISE.draw(Surface.of_faces(frame), 800, rng) for frame in motion]
    errors = trial_errors(clouds, motion, NOISE)
    assert errors.chamfer == pytest.approx(np.mean([chamfer(c, m) for c, m in zip(clouds, motion, strict=True)]))
    assert errors.chamfer == pytest.approx(errors.chamfer_floor, rel=0.02)  # the model is the truth
    assert errors.surface_rms == pytest.approx(errors.surface_floor, rel=0.05)
    motion[2, 5] = np.nan
    diverged = trial_errors(clouds, motion, NOISE)
    assert np.isnan(diverged.chamfer)
    table = statistics([errors, diverged, Errors(0.02, 0.004, 0.01, 0.0006)])
    assert table["chamfer"].max == 0.02
    assert table["chamfer"].mean == pytest.approx((errors.chamfer + 0.02) / 2)
    with pytest.raises(ValueError, match="3 measured frames, 2 predicted"):
        trial_errors(clouds, motion[:2], NOISE)


@pytest.mark.parametrize("reach", [0.012, 0.05])
def test_the_true_surface_is_at_the_floor_of_its_own_clouds(reach):
    """0.3 % strays make half of the mean square, so their share must come out right: an excess of 0.15 mm is 4 %."""
    rng = np.random.default_rng(7)
    motion = np.stack([rolled_sheet(c) for c in np.linspace(0.0, 10.0, 40)]).astype(np.float32)
    clouds = [SensorNoise(0.0006, 0.003, reach).draw(Surface.of_faces(frame), 1500, rng) for frame in motion]
    errors = trial_errors(clouds, motion, estimate_noise(clouds, 0.002))
    assert abs(errors.surface_rms**2 - errors.surface_floor**2) < 0.00015**2


def test_closed_share():
    """Chamfer (7 - 5) / (7 - 4); surface, noise 3 off in quadrature, (4 - 2) / 4 from 5 and sqrt(13)."""
    share = closed(Errors(0.007, 0.0041, 0.005, 0.003), Errors(0.005, 0.004, np.sqrt(13) * 1e-3, 0.003))
    assert share.chamfer == pytest.approx(2 / 3)
    assert share.surface == pytest.approx(0.5)
    assert closed(Errors(0.004, 0.004, 0.003, 0.003), Errors(0.004, 0.004, 0.003, 0.003)).surface is None


@dataclass(frozen=True)
class Motion:
    order: int
    role: str
    kilopascals: float
    file: Path = Path("none.npz")

    @property
    def program(self):
        return PressureProgram(np.zeros(1), np.array([[self.kilopascals * 1e3]]), 1.5)


TRIALS = [
    Motion(i, "test" if i == 9 else "fit", (100, 200, 300, 100, 200, 400, 0, 50, 100.00001, 77)[i]) for i in range(10)
]


def test_repeats_stay_on_one_side_and_test_trials_out():
    for part in (*folds(TRIALS, 3), split(TRIALS, 0.3, seed=1)):
        fit, held_out = ({round(t.kilopascals) for t in side} for side in (part.fit, part.held_out))
        assert fit
        assert held_out
        assert not fit & held_out
        assert 77 not in fit | held_out
        assert len(part.fit) + len(part.held_out) == 9
    held_out_once = sorted(t.order for part in folds(TRIALS, 3) for t in part.held_out)
    assert held_out_once == list(range(9))
    assert split(TRIALS, 0.3, seed=1) == split(TRIALS, 0.3, seed=1)


def test_nothing_is_fitted_on_test_trials():
    assert [t.order for t in fit_trials(TRIALS, [0, 2])] == [0, 2]
    with pytest.raises(InputError, match="order 9 has role test"):
        fit_trials(TRIALS, [0, 9])
    with pytest.raises(InputError, match="no trial of order 42"):
        fit_trials(TRIALS, [42])
    with pytest.raises(InputError, match="same pressures"):
        split(TRIALS[:1], 0.5)


def test_points_beyond_the_cap_are_counted_and_said():
    """Of 400 points on the front face three in ten are moved off it, 11 or 30 mm: the capped RMS is the same."""
    face = np.stack([*np.meshgrid(np.linspace(-0.1, 0.1, 20), np.linspace(-0.2, 0, 20)), np.full((20, 20), 1e-3)], -1)
    face = face.reshape(-1, 3)
    model = np.concatenate([face, face * [1, 1, -1]])
    errors = []
    for far in (0.011, 0.030):
        cloud = face.copy()
        cloud[:120, 2] += far
        errors.append(trial_errors([cloud], model[None], NOISE))
        assert errors[-1].beyond == pytest.approx(0.3)
    assert errors[0].surface_rms == pytest.approx(errors[1].surface_rms)
    assert errors[0].surface_rms == pytest.approx(0.010 * np.sqrt(0.3))
    assert beyond_in_words(0.3).startswith(
        "30.0% of the points lie more than 10 mm off; the surface RMS is capped there"
    )
    assert beyond_in_words(0.012) == "1.2% of the points lie more than 10 mm off"
