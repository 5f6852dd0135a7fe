"""Effects of a muscle found on its bench: a known truth, made by other code, and the way into a design."""

import json
from functools import partial

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.files.bench_file import read_bench
from fabdesign.files.design_file import read_design, write_design
from fabdesign.formats.csv_table import write_rows
from fabdesign.nouns.catalogue import build
from studies.benches.calibrate import bench_vector, calibrate_bench, fit_effects
from studies.benches.muscle import BenchMuscle, rows_of

STEP = 1e-3  # s, of the truth


def law(p, eps):
    return 4e-5 * p * np.clip(1 - 3 * eps, 0, None) - 55 * eps + 200 * np.maximum(-eps, 0)


def record(name, seed=0):
    """Steps of pressure while the contraction sweeps, stops and sweeps back: kPa, 1, N."""
    rng = np.random.default_rng(seed)
    time = np.arange(0, 20, STEP)
    command = 50e3 * rng.integers(0, 9, 21)[(time / 1.0).astype(int)]
    turns = rng.uniform(0.02, 0.2, 15)
    eps = np.interp(time, 1.5 * np.arange(15), turns)
    if name != "muscle_viscosity":  # which a jump would make infinite
        eps = np.where((time % 6) > 4, np.interp(time - time % 6 + 4, time, eps), eps)  # holds
    p, z, g, pressure, lent, rubbed = command[0], 0.3 * eps[0], 0.0, [], [], []
    if name != "muscle_creep":
        z = 0.0
    before = eps[0]
    for goal, e in zip(command, eps, strict=True):
        if name == "filling_lag":
            p += STEP * (goal - p) / (0.15 if goal > p else 0.3)
        else:
            p = goal
        if name == "muscle_creep":
            z += STEP * (0.3 * max(e, 0) - z) / 0.8
        if name == "braid_hysteresis":
            limit = 0.1 + 4e-6 * p
            g = np.clip(g + limit / 0.01 * (e - before), -limit, limit)
        if name == "muscle_viscosity":
            rate = (e - before) / STEP
            g = (20.0 if rate > 0 else 4.0) * rate
        before = e
        pressure.append(p)
        lent.append(z)
        rubbed.append(g)
    force = law(np.array(pressure), eps - np.array(lent)) - np.array(rubbed)
    rows = slice(None, None, EVERY[name])
    noisy = force[rows] + 0.05 * rng.standard_normal(len(force[rows]))
    return time[rows], command[rows], eps[rows], noisy


def bench(folder, name):
    (folder / "bench.toml").write_text(
        'format = "fabdesign.bench/1"\nspecimen = "muscle"\nname = "EM20"\n'
        'input = ["pressure_command_kpa", "contraction"]\noutput = "force_n"\n'
        "[constants]\nouter_diameter = 0.002\nmass_per_length = 0.0036\naxis_offset = 0.0009\n"
        + "".join(f'[[records]]\nfile = "r{i}.csv"\n' for i in range(2))
    )
    for i in range(2):
        time, command, eps, force = record(name, i)
        columns = ("time_s", "pressure_command_kpa", "contraction", "force_n")
        rows = zip(time.tolist(), (command / 1e3).tolist(), eps.tolist(), force.tolist(), strict=True)
        write_rows(folder / f"r{i}.csv", columns, list(rows))
    return folder


# rows of the truth in one of the record: of friction, rows must show where it turns
EVERY = {
    "muscle_creep": 20, "braid_hysteresis": 5, "filling_lag": 20, "muscle_viscosity": 2,
}  # fmt: skip
TRUTH = {
    "muscle_creep": {"share": 0.3, "time": 0.8},
    "braid_hysteresis": {"friction": 0.004, "friction_at_zero": 0.1, "slip": 0.01},
    "filling_lag": {"fill": 0.15, "empty": 0.3},
    "muscle_viscosity": {"contracting": 20.0, "lengthening": 4.0},
}


@pytest.mark.parametrize("name", TRUTH)
def test_a_bench_gives_an_effect_back(name, tmp_path):
    records = read_bench(bench(tmp_path, name)).records
    [effect] = fit_effects(partial(rows_of, records), bench_vector([name], "EM20"))
    misfits = [BenchMuscle.fit(records, terms=terms).misfit for terms in ((), (effect.term,))]
    assert misfits[1] < 0.08 < 0.8 * misfits[0]  # 0.05 N is the noise
    for key, true in TRUTH[name].items():
        q = effect.parameters[key]
        assert q.value == pytest.approx(true, rel=0.15)
        low, high = q.interval90
        assert low < q.value < high and high - low < 0.5 * true


def test_it_travels_with_the_type_and_a_lag_does_not(tmp_path, run):
    folder = bench(tmp_path, "muscle_creep")
    free = "muscle_creep,filling_lag.fill,filling_lag:empty=0"
    code, out, err = run("calibrate", folder, "--free", free, "-o", tmp_path / "type.toml", "--json")
    assert code == 0, err
    assert [effect["name"] for effect in json.loads(out)["effects"]] == ["muscle_creep", "filling_lag"]
    write_design(build("cross"), tmp_path / "whole.toml")
    head, rest = (tmp_path / "whole.toml").read_text().split("[muscle_types.", 1)
    (tmp_path / "d.toml").write_text(f'include = ["type.toml"]\n{head}[[muscles]]{rest.split("[[muscles]]", 1)[1]}')
    [term] = read_design(tmp_path / "d.toml").effects
    assert (term.name, term.scope) == ("muscle_creep", "muscle_types.EM20")
    assert term.values["share"] == pytest.approx(0.3, rel=0.2)


def test_what_a_bench_cannot_show_is_refused(tmp_path):
    folder = bench(tmp_path, "muscle_creep")
    with pytest.raises(InputError, match="one muscle on its bench does not show it; expected braid_hysteresis"):
        calibrate_bench(folder, free=["line_loss"])
    with pytest.raises(InputError, match="does not show it"):  # the bench's own law begins where it does
        calibrate_bench(folder, free=["threshold_pressure"])
    with pytest.raises(InputError, match="did you mean muscle_creep"):
        calibrate_bench(folder, free=["muscle_crep"])
