"""Noise of a bench's readings, of made records whose noise is known, and what a trace makes of friction beside it."""

import numpy as np
import pytest

from fabdesign.nouns.bench import Bench, BenchRecord
from studies.benches.cylinder import friction_state
from studies.benches.records import noise_of
from studies.benches.trace_report import as_text
from studies.benches.tracing import examine
from tests.benches.test_benches import muscle_force

SIGMA = 0.05  # N
Array = np.ndarray


def quiet(readings: int) -> dict[str, Array]:
    """Return sweeps out and back at nine pressures with friction of 0.12 N/bar, SI, without noise."""
    pressure = np.repeat(np.arange(0, 4.1e5, 50e3), 2 * readings)
    one_way = np.linspace(-0.02, 0.22, readings)
    contraction = np.tile(np.r_[one_way, one_way[::-1]], 9)
    force = muscle_force(pressure, contraction) - 0.12e-5 * pressure * friction_state(contraction, 0.005)
    return {"pressure": pressure, "contraction": contraction, "force": force}


def bench(*noises: Array, readings: int = 24, step: float = 0.0, shift: float = 0.0) -> Bench:
    """Return a bench with a record for each noise. step: of a quantised gauge, N. shift: of contraction, by record."""
    columns, records = quiet(readings), []
    for k, noise in enumerate(noises):
        force = columns["force"] + noise
        moved = columns["contraction"] + shift * k
        force = np.round(force / step) * step if step else force
        records.append(BenchRecord(f"r{k}", columns | {"contraction": moved, "force": force}, {}))
    return Bench("made", "muscle", (), "force", {}, tuple(records))


def white(readings: int, count: int = 1) -> list[Array]:
    rng = np.random.default_rng(3)
    return [SIGMA * rng.standard_normal(18 * readings) for _ in range(count)]


def test_repeats_show_it_however_coarse_the_steps() -> None:
    noise = noise_of(bench(*white(6, 3), readings=6))
    assert noise.source == "repeats" and noise.sigma == pytest.approx(SIGMA, rel=0.1)


@pytest.mark.parametrize("readings", [24, 100])
def test_neighbours_show_it_and_no_friction_is_taken_for_it(readings: int) -> None:
    noise = noise_of(bench(*white(readings, 2), readings=readings, shift=0.001))
    assert noise.source == "neighbours" and noise.sigma == pytest.approx(SIGMA, rel=0.15)


def test_coarse_steps_without_repeats_do_not_show_it() -> None:
    noise = noise_of(bench(*white(8), readings=8))
    assert noise.source == "unknown" and noise.sigma == 0.0 and "coarse" in noise.in_words("")


def test_a_quantised_gauge_has_the_noise_of_its_steps() -> None:
    noise = noise_of(bench(np.zeros(1800), readings=100, step=0.3))
    assert noise.sigma == pytest.approx(0.3 / np.sqrt(12), rel=0.3)


def test_noise_that_is_correlated_over_a_few_readings_is_not_halved() -> None:
    white_noise, noise = white(200)[0], np.zeros(3600)
    for k in range(1, len(noise)):
        noise[k] = 0.5 * noise[k - 1] + np.sqrt(0.75) * white_noise[k]
    made = bench(noise, readings=200)
    assert noise_of(made).sigma == pytest.approx(SIGMA, rel=0.15)


def test_holds_show_it() -> None:
    columns = {name: np.repeat(values[:48], 20) for name, values in quiet(24).items()}
    columns["force"] = columns["force"] + SIGMA * np.random.default_rng(3).standard_normal(960)
    record = BenchRecord("holds", columns, {})
    assert noise_of(Bench("made", "muscle", (), "force", {}, (record,))).sigma == pytest.approx(SIGMA, rel=0.1)


def test_friction_is_named_and_not_taken_for_noise() -> None:
    made = bench(*white(12, 3), readings=12)
    within = examine(made, 0.02)
    assert within.verdict == "adequate" and within.small is not None and within.small.name == "braid_hysteresis"
    assert within.floor == pytest.approx(SIGMA, rel=0.15) and "not added" in as_text(within)
    outcome = examine(made, 0.005)
    assert outcome.verdict == "effect" and [effect.name for effect in outcome.effects] == ["braid_hysteresis"]
    assert outcome.effects[0].parameters["friction"].value == pytest.approx(1.2e-3, rel=0.2)  # N/kPa
    assert outcome.evidence.after < 0.2 * outcome.evidence.before
