"""A bench evaluated with what calibrate wrote: the law in the file predicts as the law that was fitted."""

import json
from pathlib import Path

import numpy as np
import pytest

from studies.benches.calibrate import calibrate_bench
from studies.benches.evaluate import evaluate_bench
from studies.benches.write import write_bench_type
from tests.benches.test_benches import j_force
from tests.command_line import Run, one_line
from tests.tracing.test_trace_bench import PRESSURES, actuator, cylinder, muscle

SIZES = "[constants]\nouter_diameter = 0.002\nmass_per_length = 0.004\naxis_offset = 0.001\n"
SCALE = {"pressure_kpa": 1e-3, "pressure_amplitude_kpa": 1e-3}


def strip(rng: np.random.Generator, share: float) -> dict[str, np.ndarray]:
    stretch = np.linspace(1, 1.6, 150)
    return {"stretch": stretch, "force": share * j_force(stretch) + 0.02 * rng.standard_normal(150)}


# specimen: what is made, arguments a record, header, output, constants
MADE = {
    "cylinder": (cylinder, [(p, 4e-3, 2.0) for p in PRESSURES], ("displacement_m", "pressure_kpa", "force_n"), ""),
    "muscle": (muscle, [(30.0,)] * 3, ("time_s", "pressure_kpa", "contraction", "force_n"), SIZES),
    "actuator": (actuator, [(p, 0.1) for p in (1e4, 2e4, 3e4)],
                 ("time_s", "pressure_amplitude_kpa", "displacement_m"), ""),
    "strip": (strip, [(1.0,), (1.1,), (0.9,)], ("stretch", "force_n"), ""),
    "sized strip": (strip, [(1.0,), (1.1,), (0.9,)], ("stretch", "force_n"), "width = 0.05\n"),
}  # fmt: skip


def write(folder: Path, kind: str, test: int = 1) -> Path:
    """A bench of which the last `test` records have role test."""
    made, arguments, header, constants = MADE[kind]
    rng = np.random.default_rng(2)
    folder.mkdir()
    text = f'format = "fabdesign.bench/1"\nname = "B"\nspecimen = "{kind.split()[-1]}"\n'
    text += f'input = {json.dumps(header[:-1])}\noutput = "{header[-1]}"\n{constants}'
    for k, values in enumerate(arguments):
        columns = made(rng, *values)
        table = [SCALE.get(name, 1.0) * columns[name.rpartition("_")[0] or name] for name in header]
        np.savetxt(folder / f"r{k}.csv", np.stack(table, axis=1), delimiter=",", header=",".join(header), comments="")
        role = "test" if k >= len(arguments) - test else "fit"
        text += f'[[records]]\nfile = "r{k}.csv"\nrole = "{role}"\n'
    (folder / "bench.toml").write_text(text)
    return folder


@pytest.mark.parametrize("kind", MADE)
def test_the_file_predicts_as_the_law_that_was_fitted(kind: str, tmp_path: Path) -> None:
    folder = write(tmp_path / "bench", kind)
    fitted = calibrate_bench(folder)
    write_bench_type(fitted, tmp_path / "out" / "type.toml")
    evaluation = evaluate_bench(folder, tmp_path / "out" / "type.toml", ["test", "fit"])
    assert list(evaluation.tests) == [f"r{len(MADE[kind][1]) - 1}"]
    assert evaluation.unit == fitted.unit
    largest = max(float(np.abs(r.columns[r_output(kind)]).max()) for r in fitted.bench.records)
    assert evaluation.tests[next(iter(evaluation.tests))].after == pytest.approx(fitted.error_test, rel=1e-6)
    assert np.mean([e.after for e in evaluation.others.values()]) == pytest.approx(fitted.error_fit, rel=1e-6)
    assert evaluation.noise.sigma == pytest.approx(fitted.noise.sigma, rel=0.3)  # of all records, of those fitted
    for errors in evaluation.tests.values():  # before is without what motion adds
        assert errors.after < 0.5 * errors.before if kind in ("cylinder", "muscle") else errors.after == errors.before
    rms = np.sqrt(np.mean([e.after**2 for e in evaluation.others.values()]))
    assert rms == pytest.approx(fitted.error_fit, abs=0.01 * largest)
    last = evaluation.as_markdown().splitlines()[-1]  # no source: no line with a name and nothing behind it
    assert last == "RMS of each record; before: by the law at rest, after: with friction, viscosity and effects."


def r_output(kind: str) -> str:
    return "displacement" if kind == "actuator" else "force"


def test_the_command_prints_and_writes_a_table(tmp_path: Path, run: Run) -> None:
    folder, law = write(tmp_path / "bench", "cylinder"), tmp_path / "law.toml"
    assert run("calibrate", folder, "-o", law)[0] == 0
    code, out, err = run("evaluate", folder, "--model", law, "--all", "-o", tmp_path / "out", "--json")
    assert code == 0, err
    evaluation = json.loads(out)
    assert evaluation == json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert evaluation["metric"] == "rms" and evaluation["unit"] == "N"
    assert {"mean", "max", "min", "std"} == evaluation["designs"]["B"]["after"]["rms"].keys()
    assert evaluation["designs"]["B"]["after"]["rms"]["mean"] < evaluation["designs"]["B"]["before"]["rms"]["mean"]
    assert len(evaluation["others"]["B"]["records"]) == 3
    assert "| mean |" in run("evaluate", folder, "--model", law)[1]


def test_what_cannot_be_is_refused_in_a_line(tmp_path: Path, run: Run) -> None:
    tested, untested = write(tmp_path / "a", "strip"), write(tmp_path / "b", "strip", test=0)
    tube, law = write(tmp_path / "c", "cylinder"), tmp_path / "law.toml"
    assert run("calibrate", tested, "-o", law)[0] == 0
    one_line(run("evaluate", tube, "--model", law), "the law of specimen strip")
    one_line(run("evaluate", untested, "--model", law), "no record of role test; expected one, or --all")
    one_line(run("evaluate", tested, untested, "--model", law), "expected a bench alone, or sets")
    (tmp_path / "m.toml").write_text('format = "fabdesign.model/1"\n')
    one_line(run("evaluate", tested, "--model", tmp_path / "m.toml"), "fabdesign.model/1")
    one_line(run("evaluate", tested, "--model", tmp_path / "none.toml"), "none.toml")
