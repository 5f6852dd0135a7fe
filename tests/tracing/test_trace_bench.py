"""A trace of a bench: what was put into made records is found, and nothing where nothing was."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from fabdesign.files.model_file import read_model
from fabdesign.nouns.bench import Bench, BenchRecord, Specimen
from studies.benches.cylinder import friction_state
from studies.benches.records import LAWS
from studies.benches.trace_report import BenchOutcome, as_text
from studies.benches.tracing import examine
from tests.benches.test_benches import DATA, muscle_force
from tests.command_line import Run, one_line

TIGHT = 0.005  # of the largest output
Rng = np.random.Generator


def cylinder(rng: Rng, pressure: float, friction: float, at_zero: float, creep: float = 0.0) -> dict[str, np.ndarray]:
    """Four strokes in 40 s; 5 cm^2; friction in N/kPa. creep: share of the force over pressure, which comes on at 4 s,
    that is late by 6 s."""
    time = np.linspace(0, 40, 800)
    on = time > 4 if creep else np.ones(800, dtype=bool)
    x = 0.02 - 0.02 * np.cos(0.2 * np.pi * time)
    force = on * 5e-4 * pressure * (1 - creep * np.exp(-(time - 4) / 6)) + 20 * x
    force += (at_zero + friction * pressure / 1e3) * friction_state(x, 8e-4) + 0.05 * rng.standard_normal(800)
    return {"time": time, "displacement": x, "pressure": pressure * on, "force": force}


def muscle(rng: Rng, viscosity: float) -> dict[str, np.ndarray]:
    """Contraction swept back and forth at two rates, pressure in steps."""
    time = np.arange(0, 24, 0.06)
    contraction = 0.1 - 0.12 * np.cos(2 * np.pi * (np.minimum(time, 12) / 4 + np.maximum(time - 12, 0) / 1.5))
    pressure = 50e3 * (np.floor(time / 24 * 18) % 9)
    force = muscle_force(pressure, contraction) - viscosity * np.gradient(contraction, time)
    return {
        "time": time,
        "pressure": pressure,
        "contraction": contraction,
        "force": force + 0.05 * rng.standard_normal(len(time)),
    }


def actuator(rng: Rng, pressure: float, lag: float) -> dict[str, np.ndarray]:
    """Pressure on at 0.5 s and off at 3 s; what moves is late by a lag [s]."""
    time = np.arange(0, 4, 0.01)
    rise = 1 - np.exp(-np.maximum(time - 0.5, 0) / lag)
    moved = 2e-7 * pressure * rise * np.exp(-np.maximum(time - 3, 0) / lag)
    return {
        "time": time,
        "pressure_amplitude": np.full(len(time), pressure),
        "displacement": moved + 1e-5 * rng.standard_normal(len(time)),
    }


def strip(rng: Rng, relaxing: float) -> dict[str, np.ndarray]:
    """Stretched within 1 s and held; a share of the force goes within 6 s."""
    time = np.linspace(0, 20, 400)
    stretch = 1 + 0.3 * np.minimum(time, 1)
    force = 20 * (stretch - 1) * (1 + relaxing * np.exp(-time / 6)) + 0.02 * rng.standard_normal(400)
    return {"time": time, "stretch": stretch, "force": force}


def traced(
    specimen: Specimen,
    made: Callable[..., dict[str, np.ndarray]],
    *arguments: Sequence[float],
    tolerance: float = TIGHT,
) -> BenchOutcome:
    rng = np.random.default_rng(4)
    records = tuple(BenchRecord(f"r{k}", made(rng, *parameters), {}) for k, parameters in enumerate(arguments))
    output = "displacement" if specimen == "actuator" else "force"
    return examine(Bench("made", specimen, (), output, {}, records), tolerance)


PRESSURES = 1e5, 3e5, 5e5, 7e5


def test_friction_that_grows_with_pressure_is_found_on_a_cylinder() -> None:
    outcome = traced("cylinder", cylinder, *((p, 4e-3, 2.0) for p in PRESSURES))
    (effect,) = outcome.effects
    assert outcome.verdict == "effect" and effect.name == "braid_hysteresis"
    assert effect.parameters["friction"].value == pytest.approx(4e-3, rel=0.1)  # N/kPa
    assert effect.parameters["friction_at_zero"].value == pytest.approx(2.0, rel=0.1)
    assert effect.parameters["slip"].value == pytest.approx(8e-4, rel=1e-3)
    assert outcome.evidence.after < 0.3 * outcome.evidence.before  # the highest pressure is beyond the others'


def test_on_a_cylinder_without_any_the_law_is_adequate() -> None:
    outcome = traced("cylinder", cylinder, *((p, 0.0, 0.0) for p in PRESSURES))
    assert outcome.verdict == "adequate" and not outcome.effects


@pytest.mark.parametrize(("creep", "chosen"), [(0.2, True), (-0.2, False)])
def test_what_has_the_wrong_sign_is_no_effect(creep: float, chosen: bool) -> None:
    """The force of a cylinder that loses some of it with time is no creep: that only ever adds."""
    outcome = traced("cylinder", cylinder, *((p, 0.0, 0.0, creep) for p in PRESSURES))
    assert ("muscle_creep" in {effect.name for effect in outcome.effects}) == chosen
    assert ("muscle_creep" in [c.name for c in outcome.candidates if c.refused]) != chosen
    assert ("only with a sign that it cannot have" in as_text(outcome)) != chosen


def test_viscosity_is_found_on_a_muscle() -> None:
    outcome = traced("muscle", muscle, *[(30.0,)] * 3)
    (effect,) = outcome.effects
    assert outcome.verdict == "effect" and effect.name == "muscle_viscosity"
    assert [q.value for q in effect.parameters.values()] == pytest.approx([30, 30], rel=0.05)


def test_a_muscles_law_takes_the_pressure_commanded_where_none_was_measured() -> None:
    rng = np.random.default_rng(4)
    measured = [BenchRecord(f"r{k}", muscle(rng, 30.0), {}) for k in range(2)]
    commanded = [
        BenchRecord(r.name, {"pressure_command" if k == "pressure" else k: v for k, v in r.columns.items()}, {})
        for r in measured
    ]
    forces = [LAWS["muscle"].still(pair[:1], pair[1]) for pair in (measured, commanded)]
    np.testing.assert_array_equal(*forces)


def test_a_lag_is_found_on_an_actuator(monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = traced("actuator", actuator, *((p, 0.1) for p in (1e4, 2e4, 3e4, 4e4)))
    (effect,) = outcome.effects
    assert effect.name == "filling_lag" and effect.parameters["time"].value == 0.1
    assert effect.parameters["share"].value == pytest.approx(1.0, abs=0.05)
    assert outcome.evidence.after < 0.1 * outcome.evidence.before
    for unit in ("m", "mm"):  # whose name scales nothing
        monkeypatch.setattr(BenchOutcome, "unit", unit)
        error = outcome.to_json()["error"]
        assert (error["unit"], error["tolerance"]) == (unit, outcome.tolerance)
    without = [
        traced("actuator", actuator, *((p, 1e-3) for p in (1e4, 2e4, 3e4, 4e4)), tolerance=t) for t in (TIGHT, 0.02)
    ]
    # what the records left out do not share is beyond the tight tolerance: no effect, and not adequate either
    assert [one.verdict for one in without] == ["unexplained", "adequate"]
    assert not any(one.effects for one in without)


def test_relaxation_is_found_on_a_strip() -> None:
    outcome = traced("strip", strip, *[(0.3,)] * 4)
    assert [effect.name for effect in outcome.effects] == ["stress_relaxation"]
    assert traced("strip", strip, *[(0.0,)] * 4).verdict == "adequate"


def write(folder: Path, pressures: Sequence[float]) -> None:
    rng = np.random.default_rng(4)
    folder.mkdir()
    lines = ['format = "fabdesign.bench/1"', 'specimen = "cylinder"', 'name = "made"', 'description = "made"']
    lines += ['input = ["displacement_m", "pressure_kpa"]', 'output = "force_n"']
    for k, pressure in enumerate(pressures):
        columns = cylinder(rng, pressure, 4e-3, 2.0)
        table = np.column_stack([columns["displacement"], columns["pressure"] / 1e3, columns["force"]])
        header = "displacement_m,pressure_kpa,force_n"
        np.savetxt(folder / f"r{k}.csv", table, delimiter=",", header=header, comments="")
        lines += ["[[records]]", f'file = "r{k}.csv"']
    (folder / "bench.toml").write_text("\n".join(lines) + "\n")


def test_the_command_writes_what_it_found(tmp_path: Path, run: Run) -> None:
    write(tmp_path / "bench", PRESSURES)
    code, out, err = run("trace", tmp_path / "bench", "--tolerance", "0.5", "-o", tmp_path / "out", "--json")
    assert code == 0, err
    result = json.loads(out)
    assert result == json.loads((tmp_path / "out" / "trace.json").read_text())
    assert result["format"] == "fabdesign.trace/1" and result["verdict"] == "effect"
    assert result["error"]["after"]["held_out"] < result["error"]["before"]["held_out"]
    assert [effect["name"] for effect in result["effects"]] == ["braid_hysteresis"]
    assert [row["name"] for row in result["candidates"] if row["chosen"]] == ["braid_hysteresis"]
    assert result["candidates"][0]["name"] == "none"  # as of a set
    assert read_model(tmp_path / "out" / "model.toml").effects == ()  # its slip is a length, a muscle's none
    assert "Missing was braid hysteresis" in (tmp_path / "out" / "report.html").read_text()


def test_records_of_role_test_are_looked_at_once_at_the_end(tmp_path: Path, run: Run) -> None:
    write(tmp_path / "bench", (*PRESSURES, 6e5))
    command = ("trace", tmp_path / "bench", "--tolerance", "0.5", "--json")
    without_test = json.loads(run(*command, "-o", tmp_path / "whole")[1])
    file = tmp_path / "bench" / "bench.toml"
    file.write_text(file.read_text().replace('file = "r4.csv"', 'file = "r4.csv"\nrole = "test"'))
    result = json.loads(run(*command, "-o", tmp_path / "out")[1])
    error = result["error"]
    assert error["after"]["held_out"] < 0.3 * error["before"]["held_out"]
    assert error["before"]["fit"] != without_test["error"]["before"]["fit"]  # it took no part
    assert error["before"]["cross_validated"] != error["before"]["held_out"]
    assert without_test["error"]["before"]["cross_validated"] == without_test["error"]["before"]["held_out"]
    csv = tmp_path / "bench" / "r4.csv"
    header, *rows = csv.read_text().splitlines()
    csv.write_text("\n".join([header, *(f"{row.rpartition(',')[0]},0" for row in rows)]) + "\n")
    again = json.loads(run(*command, "-o", tmp_path / "again")[1])
    assert again["candidates"] == result["candidates"] and again["effects"] == result["effects"]


def test_two_records_are_refused(tmp_path: Path, run: Run) -> None:
    write(tmp_path / "bench", PRESSURES[:2])
    one_line(run("trace", tmp_path / "bench", "-o", tmp_path / "out"), "2 records of role fit; expected at least 3")
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(not DATA.is_dir(), reason="the real benches are not here")
@pytest.mark.parametrize("name", ["kidney_lc", "stadium_lc", "x-ring257"])
def test_real_cylinders_lack_friction(name: str, tmp_path: Path, run: Run) -> None:
    code, out, err = run("trace", DATA / "cylinder_friction" / name, "-o", tmp_path / "out", "--json")
    assert code == 0, err
    assert [effect["name"] for effect in json.loads(out)["effects"]] == ["braid_hysteresis"]
