"""Sweeps: estimators against exact values, studies on a cloth in closed form, and a small one on the simulator."""

import csv
import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import sobol_indices

from fabdesign.errors import InputError, SimulationError
from fabdesign.files.design_file import write_design
from fabdesign.geometry.shape import mean_curvature, tip
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Covariance, EffectTerm, Model, Parameter, Quantity
from fabdesign.nouns.model_sampling import Ensemble
from fabdesign.study_files.sensitivity_file import SensitivityStudy, Varied
from fabdesign.study_files.study_targets import read_shape_output
from studies.prediction.stability import snaps
from studies.sensitivity.report import as_text, bars_figure
from studies.sensitivity.result import indices, screening
from studies.sensitivity.run import Progress, run_sensitivity
from studies.sensitivity.variables import STEP, Inputs, Outputs, saltelli_rows, trajectories
from tests.analytic_cloth import AnalyticCloth
from tests.command_line import Run, one_line

HEAD = 'format = "fabdesign.study/1"\nkind = "sensitivity"\ndesign = "d.toml"\n'
TWO = "[parameters.pressure.0]\nlow = 100\nhigh = 300\n[parameters.position.1.u]\nlow = -0.01\nhigh = 0.01\n"


def ishigami(x: np.ndarray) -> np.ndarray:
    """Of points of the unit cube (..., 3)."""
    x = np.pi * (2 * x - 1)
    return np.sin(x[..., 0]) + 7 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0])


def sobol_g(x: np.ndarray, a: np.ndarray) -> np.ndarray:
    return np.prod((np.abs(4 * x - 2) + a) / (1 + a), axis=-1)


def single(inputs: int) -> list[tuple[int, ...]]:
    return [(i,) for i in range(inputs)]


# estimators


def test_sobol_indices_of_ishigami_are_the_exact_ones() -> None:
    rows = saltelli_rows(3, [*single(3), (0, 2)], 4096, seed=1)
    estimates = indices(ishigami(rows))
    v1, v2, v13 = 0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2, 49 / 8, 0.01 * np.pi**8 * (1 / 18 - 1 / 50)
    variance = v1 + v2 + v13
    np.testing.assert_allclose(estimates["first"], np.array([v1, v2, 0, v1 + v13]) / variance, atol=0.01)
    np.testing.assert_allclose(estimates["total"], np.array([v1 + v13, v2, v13, v1 + v13]) / variance, atol=0.01)


def test_sobol_indices_of_the_g_function_are_the_exact_ones_and_lie_in_their_intervals() -> None:
    a = np.array([0, 1, 4.5, 9, 99, 99])
    partial_variances = 1 / (3 * (1 + a) ** 2)
    variance = np.prod(1 + partial_variances) - 1
    first = partial_variances / variance
    total = partial_variances * np.prod(1 + partial_variances) / (1 + partial_variances) / variance
    estimates = indices(sobol_g(saltelli_rows(6, single(6), 2048, seed=3), a))
    np.testing.assert_allclose(estimates["first"], first, atol=0.015)
    np.testing.assert_allclose(estimates["total"], total, atol=0.015)
    rough_estimates = [indices(sobol_g(saltelli_rows(6, single(6), 64, seed), a), seed=seed) for seed in range(8)]
    inside = [
        (x["first_interval90"][:4, 0] <= first[:4]) & (first[:4] <= x["first_interval90"][:4, 1])
        for x in rough_estimates
    ]
    assert np.mean(inside) >= 0.8
    assert np.ptp(rough_estimates[0]["first_interval90"][0]) > 0.1


def test_sobol_estimators_are_those_of_scipy() -> None:
    values = ishigami(saltelli_rows(3, single(3), 256, seed=0))
    theirs = sobol_indices(
        func={"f_A": values[:, 0][None], "f_B": values[:, 1][None], "f_AB": values[:, 2:].T[:, None]}, n=256
    )
    estimates = indices(values)
    np.testing.assert_allclose(estimates["first"], np.ravel(theirs.first_order), rtol=1e-9)
    np.testing.assert_allclose(estimates["total"], np.ravel(theirs.total_order), rtol=1e-9)


def test_morris_measures_are_those_of_all_elementary_effects() -> None:
    levels = [0, 1 / 3]
    grid = [0, 1 / 3, 2 / 3, 1]
    exact = np.empty((3, 2))
    for i in range(3):
        spans = [levels if k == i else grid for k in range(3)]
        starts = np.array([*product(*spans)])
        effects = (ishigami(starts + STEP * np.eye(3)[i]) - ishigami(starts)) / STEP
        exact[i] = np.abs(effects).mean(), effects.std()
    paths = trajectories(3, 4000, seed=2)
    measures = screening(paths, ishigami(paths))
    np.testing.assert_allclose(measures["mu_star"], exact[:, 0], rtol=0.03, atol=1e-9)
    np.testing.assert_allclose(measures["sigma"], exact[:, 1], rtol=0.03, atol=1e-9)


def test_morris_ranks_the_g_function_and_finds_a_linear_one_exactly() -> None:
    paths = trajectories(6, 40, seed=1)
    assert {*np.unique(np.round(3 * paths))} == {0, 1, 2, 3}
    order = np.argsort(-screening(paths, sobol_g(paths, np.array([0, 1, 4.5, 9, 99, 99])))["mu_star"])
    assert order[:4].tolist() == [0, 1, 2, 3]
    slope = np.array([3.0, -2, 0, 1, 0.5, -5])
    measures = screening(paths, paths @ slope)
    np.testing.assert_allclose(measures["mu"], slope, atol=1e-12)
    np.testing.assert_allclose(measures["mu_star"], abs(slope), atol=1e-12)
    np.testing.assert_allclose(measures["sigma"], 0, atol=1e-12)


@pytest.mark.parametrize("make", [trajectories, lambda d, n, seed: saltelli_rows(d, single(d), n, seed)])
def test_a_longer_design_begins_with_the_shorter_one(make) -> None:
    np.testing.assert_array_equal(make(5, 64, 7)[:16], make(5, 16, 7))


# outputs


def test_mean_curvature_and_tip_of_a_cylinder() -> None:
    u, s = np.meshgrid(np.linspace(-0.1, 0.1, 41), np.linspace(0, 0.2, 41))
    for turn in (1, -1):  # hollow to the front, to the back
        faces = []
        for half in (1e-3, -1e-3):
            r = 0.1 - turn * half
            faces.append(
                np.stack([u, -r * np.sin(s / 0.1), turn * (0.1 - r * np.cos(s / 0.1))], axis=-1).reshape(-1, 3)
            )
        points = np.concatenate(faces)
        assert mean_curvature(points) == pytest.approx(turn * 5, rel=2e-3)
        expected = [0, -0.1 * np.sin(2), turn * 0.1 * (1 - np.cos(2))]
        np.testing.assert_allclose(tip(points, build("cross").fabric), expected, atol=1e-9)


def test_what_jumps_is_told_from_what_bends() -> None:
    moves = np.array([[0.004, 0.0005], [0.025, 0.001], [0.012, 0.006], [np.nan, np.nan]])  # m
    assert snaps(moves).tolist() == [False, True, True, True]


# studies


@pytest.fixture
def study() -> SensitivityStudy:
    varied = (
        Varied("pressure.0", "pressure", (0,), 100.0, 300.0, "kPa"),
        Varied("pressure.2", "pressure", (2,), 100.0, 300.0, "kPa"),
        Varied("position.1.u", "position", (1, -1, 0), -0.01, 0.01, "m"),
    )
    return SensitivityStudy(
        "s", build("vertical"), varied, False, ("tip",), np.full(3, 200e3), samples=32, trajectories=8
    )


class Counting(AnalyticCloth):
    """Stops after so many cases."""

    limit = 10**9
    computed = 0

    def equilibria(self, cases: Sequence[Case]) -> list[np.ndarray]:
        if len(cases) > 1:
            if self.computed + len(cases) > self.limit:
                raise KeyboardInterrupt
            self.computed += len(cases)
        return super().equilibria(cases)


def test_outputs_in_words_of_a_bent_cloth() -> None:
    """A quarter of a circle from the hung edge to the lower one, hollow to the front."""
    u, s = np.meshgrid(np.linspace(-0.1, 0.1, 41), np.linspace(0, 0.2, 41))
    r = 0.2 / (np.pi / 2)
    middle = np.stack([u, -r * np.sin(s / r), r * (1 - np.cos(s / r))], axis=-1).reshape(-1, 3)
    fabric, points = build("cross").fabric, np.concatenate([middle, middle])
    for text, unit, expected in (
        ("height of corner (0.2, 0.2)", "mm", -1e3 * r),
        ("x of corner (0.2, 0.2)", "mm", 100.0),
        ("z of (0.1, 0.2)", "mm", 1e3 * r),
        ("distance from upper-left (0, 0) to lower left (0, 0.2)", "mm", 1e3 * r * 2**0.5),
        ("angle at a (0.1, 0) from b (0.2, 0) to c (0.1, 0.2)", "degrees", 90.0),
        ("angle at (0, 0.1) from (0, 0) to (0, 0.2)", "degrees", 135.0),
    ):
        output = read_shape_output(text, fabric, "study")
        assert output.unit == unit
        assert output.of(points) == pytest.approx(expected, abs=1e-6)
    outputs = Outputs(("tip", "height of corner (0.2, 0.2)"), fabric, points)
    assert [(c.name, c.unit) for c in outputs.columns][3] == ("height of corner (0.2, 0.2)", "mm")
    np.testing.assert_allclose(outputs.of(points[None].astype(np.float32), None), [0, 0, 0, -1e3 * r], atol=1e-4)


def numbers(result: object) -> object:
    return {k: v for k, v in result.to_json().items() if k not in ("wall_s", "cpu_s")}  # type: ignore[attr-defined]


def test_a_study_says_what_matters_and_writes_it(study: SensitivityStudy, tmp_path: Path) -> None:
    reports: list[Progress] = []
    study = replace(study, outputs=("tip", "mean_curvature"))
    run_sensitivity(study, tmp_path / "out", forward=AnalyticCloth(), progress=reports.append)
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    tip_z = result["outputs"]["tip_z"]
    assert tip_z["unit"] == "mm"
    assert tip_z["sobol"]["pressure.0"]["total"] == pytest.approx(0.5, abs=0.15)  # two outer muscles alike
    assert tip_z["sobol"]["position.1.u"]["total"] < 0.1
    assert tip_z["morris"]["pressure.0"]["mu_star"] > tip_z["morris"]["position.1.u"]["mu_star"]
    assert set(result["outputs"]) == {"tip_x", "tip_y", "tip_z", "mean_curvature"}
    assert "tip_x" in result["said"][-1]  # columns of this cloth do not move sideways
    samples = result["samples"]
    assert (samples["computed"], samples["looked_at"]) == (8 * 4 + 32 * 5, 8)
    assert samples["failed"] == samples["morris_left_out"] == samples["sobol_left_out"] == samples["snapping"] == 0
    rows = [*csv.reader((tmp_path / "out" / "samples.csv").open())]
    assert len(rows) == 1 + 8 * 4 + 32 * 5
    assert rows[0][3:] == [
        "pressure.0", "pressure.2", "position.1.u", "tip_x [mm]", "tip_y [mm]", "tip_z [mm]", "mean_curvature [1/m]",
    ]  # fmt: skip
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("<svg") == 3
    assert "src=" not in page
    assert "Held, kPa: pressure.1 200." in page
    assert '<td>position.1.u</td><td class="left">shift of muscle 1 across</td>' in page
    assert reports[-1].done == reports[-1].total
    assert reports[-1].remaining == 0


@pytest.mark.parametrize("method", ["morris", "sobol"])
def test_a_page_explains_what_ran_and_its_legends_leave_the_bars_free(
    study: SensitivityStudy, tmp_path: Path, method: str
) -> None:
    result = run_sensitivity(replace(study, methods=(method,), samples=8), tmp_path / "o", forward=AnalyticCloth())
    page = (tmp_path / "o" / "report.html").read_text()
    assert ("First order: the share" in page, "mu*: mean absolute change" in page) == (
        method == "sobol",
        method == "morris",
    )
    long = tuple(f"covariance: muscle_types.EM20.{name}" for name in result.inputs.names)
    result.inputs.__dict__["names"] = long  # beside which an axis is short, and its title wide
    figure = bars_figure(result, 2)
    figure.savefig(tmp_path / "bars.png")
    for axes in figure.axes:
        legend = axes.get_legend()
        assert legend is not None
        over = legend.get_window_extent()
        assert over.y0 >= axes.get_window_extent().y1 - 1
        assert over.x1 <= figure.bbox.x1 and over.y1 <= figure.bbox.y1
        title = axes.xaxis.label.get_window_extent()
        assert figure.bbox.x0 <= title.x0 and title.x1 <= figure.bbox.x1


def test_a_study_killed_goes_on_and_ends_with_the_same_numbers(study: SensitivityStudy, tmp_path: Path) -> None:
    study = replace(study, samples=16)
    uninterrupted = run_sensitivity(study, tmp_path / "whole", forward=AnalyticCloth())
    cloth = Counting()
    cloth.limit = 60
    with pytest.raises(KeyboardInterrupt):
        run_sensitivity(study, tmp_path / "killed", forward=cloth)
    assert cloth.computed == 32  # the trajectories; the rows' first batch was lost
    cloth.limit = 10**9
    again = run_sensitivity(study, tmp_path / "killed", forward=cloth)
    assert cloth.computed == 32 + 80 + 24
    assert numbers(again) == numbers(uninterrupted)


def test_more_samples_go_further_and_another_study_is_refused(study: SensitivityStudy, tmp_path: Path) -> None:
    out, small_study = tmp_path / "out", replace(study, samples=8, methods=("sobol",))
    run_sensitivity(small_study, out, forward=AnalyticCloth())
    cloth = Counting()
    more = run_sensitivity(replace(small_study, samples=16), out, forward=cloth)
    assert cloth.computed == 8 * 5
    uninterrupted = run_sensitivity(replace(small_study, samples=16), tmp_path / "other", forward=AnalyticCloth())
    assert numbers(more) == numbers(uninterrupted)
    with pytest.raises(InputError, match="seed was 1, now 2"):
        run_sensitivity(replace(small_study, seed=2), out, forward=cloth)
    run_sensitivity(replace(small_study, seed=2), out, forward=cloth, force=True)


def test_a_limit_of_time_gives_what_is_there(study: SensitivityStudy, tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match="0 of 32 rows are whole, the time was too short"):
        run_sensitivity(replace(study, seconds=1e-9), tmp_path, forward=AnalyticCloth())
    run_sensitivity(replace(study, methods=("sobol",), samples=8), tmp_path, forward=AnalyticCloth())
    part = run_sensitivity(replace(study, methods=("sobol",), seconds=1e-9), tmp_path, forward=AnalyticCloth())
    assert not part.complete
    assert "8 of 32 rows" in part.sentences[0]
    assert "8 rows are too few to rank parameters" in part.warnings[-1]
    assert "mu*" not in as_text(part)


def test_both_methods_are_said(study: SensitivityStudy, tmp_path: Path) -> None:
    text = as_text(run_sensitivity(replace(study, samples=8), tmp_path, forward=AnalyticCloth()))
    assert "total " in text and "mu* " in text


def test_failed_samples_are_left_out_with_their_rows_and_counted(study: SensitivityStudy, tmp_path: Path) -> None:
    study = replace(study, methods=("sobol",))
    result = run_sensitivity(study, tmp_path / "some", forward=AnalyticCloth(fail_above=295e3))
    samples = result.to_json()["samples"]
    rows = [*csv.DictReader((tmp_path / "some" / "samples.csv").open())]
    lost = [r for r in rows if r["tip_z [mm]"] == ""]
    assert samples["failed"] == len(lost) > 0
    assert all(float(r["pressure.0"]) > 295 for r in lost)
    assert samples["sobol_left_out"] == len({r["row"] for r in lost if r["method"] == "sobol"})
    assert np.isfinite(result.to_json()["outputs"]["tip_z"]["mean"])
    with pytest.raises(SimulationError, match="samples failed"):
        run_sensitivity(study, tmp_path / "most", forward=AnalyticCloth(fail_above=120e3))


class Snapping(AnalyticCloth):
    """Falls to the front where the front pulls harder, by however little."""

    def equilibria(self, cases: Sequence[Case]) -> list[np.ndarray]:
        shapes = super().equilibria(cases)
        for case, shape in zip(cases, shapes, strict=True):
            side = np.sign(case.program.pressure[-1] @ [1, -0.5, -0.5])
            shape[:, 2] += 0.05 * side * shape[:, 1] / 0.2
        return shapes


def test_samples_near_a_bifurcation_are_counted(study: SensitivityStudy, tmp_path: Path) -> None:
    narrow = tuple(replace(v, low=198.0, high=202.0) if v.unit == "kPa" else v for v in study.varied)
    design = replace(
        study.design,
        muscles=tuple(replace(m, side="front" if m.channel == 0 else "back") for m in study.design.muscles),
    )
    result = run_sensitivity(
        replace(study, varied=narrow, design=design, methods=("morris",)), tmp_path, forward=Snapping()
    )
    assert result.snapping == len(result.moves) == 8
    assert any("depend partly on chance" in line for line in result.warnings)
    assert set(result.warnings) <= set(result.sentences)


def test_a_covariance_is_drawn_jointly() -> None:
    matrix = np.array([[0.04, -0.03, 0], [-0.03, 0.09, 0], [0, 0, 0.0004]])
    model = Model(
        {"bending": Parameter(1.1), "muscle_gain": Parameter(0.9, scope="muscle_types.EM20")},
        effects=(EffectTerm("filling_lag", {"fill": Quantity(0.05, "s")}),),
        covariance=Covariance(("bending", "muscle_gain", "filling_lag.fill"), matrix),
    )
    ensemble = Ensemble(model)
    z = np.random.default_rng(0).normal(size=(4000, 3))
    models = [ensemble.at(row) for row in z]
    logs = np.log([[m.parameters["bending"].factor, m.parameters["muscle_gain"].factor] for m in models])
    np.testing.assert_allclose(logs.mean(axis=0), np.log([1.1, 0.9]), atol=0.02)
    np.testing.assert_allclose(np.cov(logs.T), matrix[:2, :2], atol=0.005)
    lag = np.array([m.terms[0].values["fill"] for m in models])
    assert lag.min() == 0.0  # its bound
    assert np.median(lag) == pytest.approx(0.05, abs=0.002)
    study = SensitivityStudy("s", build("cross"), (), True, ("tip",), np.full(2, 2e5), model=model)
    inputs = Inputs(study)
    assert list(inputs.groups) == [*inputs.names, "covariance"]
    case = inputs.case(np.array([1.0, 0, 0]))
    assert case.factors["bending"] == pytest.approx(1.1 * np.exp(0.2))
    assert case.factors["muscle_types.EM20.muscle_gain"] == pytest.approx(0.9 * np.exp(-0.15))


def test_effects_of_the_model_are_varied_in_their_place(study: SensitivityStudy) -> None:
    lag = EffectTerm("filling_lag", {"fill": Quantity(0.05, "s"), "empty": Quantity(0.2, "s")})
    varied = (Varied("effects.filling_lag.fill", "effect", ("filling_lag", "fill"), 0, 0.2, "s"),)
    model = Model(effects=(lag, EffectTerm("dead_time", {"delay": Quantity(0.02, "s")})))
    case = Inputs(replace(study, varied=varied, model=model)).case(np.array([0.1]))
    assert [term.name for term in case.effects] == ["filling_lag", "dead_time"]
    assert case.effects[0].values == {"fill": 0.1, "empty": 0.2}


# files and the command


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_design(build("cross"), tmp_path / "d.toml")
    return tmp_path


def test_a_study_is_read_as_written(folder: Path) -> None:
    text = HEAD + 'method = "morris"\nat = [0.5, 1.0]\noutputs = ["tip", "largest_tension"]\n' + TWO
    (folder / "s.toml").write_text(text + '[parameters."bending"]\nlow = 0.8\nhigh = 1.2\n[limits]\nseconds = 60\n')
    study = SensitivityStudy.read(folder / "s.toml")
    assert [(v.name, v.kind, v.key) for v in study.varied] == [
        ("pressure.0", "pressure", (0,)),
        ("position.1.u", "position", (1, -1, 0)),
        ("bending", "factor", ("bending",)),
    ]
    assert (study.methods, study.at, study.seconds, study.pressures.tolist()) == (
        ("morris",), (0.5, 1.0), 60.0, [200e3, 200e3],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "parameters is missing"),
        ("[parameters]\n", "nothing varies"),
        ("[parameters]\ncovariance = true\n", "expected a model with a [covariance]"),
        ("[parameters.pressure.2]\nlow = 0\nhigh = 1\n", "channels 0 to 1"),
        ("[parameters.pressure.0]\nlow = 0\n", "no high; expected low and high kPa"),
        ("[parameters.pressure.0]\nlow = 0\nhigh = 1e9\n", "from 0 to"),
        ("[parameters.pressure.0]\nlow = 5\nhigh = 5\n", "expected low < high"),
        ("[parameters.position.0.u]\nlow = -0.15\nhigh = 0\n", "off the cloth"),
        ("[parameters.position.9.u]\nlow = -1\nhigh = 0\n", "no such muscle"),
        ("[parameters.membrain]\nlow = 0.8\nhigh = 1\n", "did you mean membrane?"),
        ("[parameters.effects.filing_lag.fill]\nlow = 0\nhigh = 1\n", "did you mean filling_lag?"),
        ("[parameters.effects.filling_lag.fil]\nlow = 0\nhigh = 1\n", "did you mean fill?"),
        ("[parameters.effects.odd_muscle.channel]\nlow = 0\nhigh = 1\n", "is a choice"),
        ("samples = 100\n" + TWO, "a power of two"),
        ('outputs = ["tips"]\n' + TWO, "some of tip, mean_curvature"),
        ('outputs = ["hight of (0, 0)"]\n' + TWO, 'expected "height of NAME (u, v)"'),
        ('outputs = ["height of a (0, 0.9)"]\n' + TWO, "expected places on the cloth, 0.2 by 0.2 m"),
        ('outputs = ["height of a (0, 1e)"]\n' + TWO, "expected two numbers"),
        ('outputs = ["distance from (0, 0) to (0, 0)"]\n' + TWO, "one place twice"),
        ('outputs = ["chamfer"]\n' + TWO, "expected one [target]"),
        ('method = "sobel"\n' + TWO, 'expected "morris", "sobol"'),
        ("at = [1.0, 0.5]\n" + TWO, "rising times"),
        ("sample = 8\n" + TWO, "unknown key sample"),
        (TWO.replace("high = 300", "hight = 300"), "no high"),
    ],
)
def test_bad_studies_are_refused_in_a_line(folder: Path, run: Run, text: str, problem: str) -> None:
    (folder / "s.toml").write_text(HEAD + text)
    one_line(run("sensitivity", folder / "s.toml", "-o", folder / "out"), problem)
    assert not (folder / "out").exists()


def test_the_command_runs_the_simulator_with_tensions_at_rest(folder: Path, run: Run) -> None:
    write_design(build("vertical"), folder / "d.toml")
    text = HEAD + 'samples = 8\nmethod = "sobol"\npoints_per_side = 11\noutputs = ["tip", "largest_tension"]\n' + TWO
    (folder / "s.toml").write_text(text)
    code, out, err = run("sensitivity", folder / "s.toml", "-o", folder / "out", "--json")
    assert code == 0, err
    result = json.loads(out)
    tension = result["outputs"]["largest_tension"]
    assert 0.1 < tension["mean"] < 30
    assert tension["sobol"]["pressure.0"]["total"] > 0.5
    assert result["samples"]["failed"] == 0
