"""Results listed, shown and compared, and their evaluations as a table."""

import csv
import json
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from fabdesign.cli.console import commands
from fabdesign.errors import InputError
from fabdesign.nouns.catalogue import build
from fabdesign.output import write_mark
from fabdesign.study_files.sensitivity_file import SensitivityStudy, Varied
from optimize.search.history import Entry, History
from studies.sensitivity.run import run_sensitivity
from tests.analytic_cloth import AnalyticCloth

ENTRIES = [
    Entry(0.5, "coarse model", 0.0123, False, (0.25, 1.0)),
    Entry(0.75, "coarse model", 1.0, True, (0.5, 0.5)),
    Entry(1.25, "full model", 0.0045, False, (0.125,)),
]


def search_folder(folder: Path, objective: float, entries: list[Entry]) -> Path:
    """A folder as `optimize` leaves it."""
    folder.mkdir(parents=True)
    with History(folder / "history.sqlite", "made up") as history:
        history.add(entries)
        history.save(None, entries[-1].seconds)
    result = {"objective_mm": objective, "evaluations": len(entries), "constraints": {"edge": 0.01}, "muscles": []}
    (folder / "result.json").write_text(json.dumps(result))
    write_mark(folder, "optimize", ["result.json", "history.sqlite"])
    return folder


def run(*words: object) -> dict[str, Any]:
    result = CliRunner().invoke(commands, ["studies", *map(str, words), "--json"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return dict(json.loads(result.output))


def test_results_are_listed_shown_and_compared(tmp_path: Path) -> None:
    a = search_folder(tmp_path / "runs" / "a", 4.5, ENTRIES)
    b = search_folder(tmp_path / "runs" / "b", 3.5, ENTRIES[:1])
    (tmp_path / "runs" / "notes").mkdir()
    listed = run("list", tmp_path)["results"]
    assert [(one["folder"], one["made_by"], one["objective_mm"]) for one in listed] == [
        (str(a), "optimize", 4.5),
        (str(b), "optimize", 3.5),
    ]
    assert run("show", a)["result"]["constraints"] == {"edge": 0.01}
    assert run("compare", a, b)["differ"] == {"objective_mm": [4.5, 3.5], "evaluations": [3, 1]}
    plain = CliRunner().invoke(commands, ["studies", "compare", str(a), str(b)]).output.splitlines()
    assert plain[1].split() == ["objective_mm", "4.5", "3.5"]
    assert run("compare", a, a)["differ"] == {}


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_every_evaluation_of_a_search_is_a_row(ending: str, tmp_path: Path) -> None:
    if ending == "parquet":
        pytest.importorskip("pyarrow")
    folder = search_folder(tmp_path / "a", 4.5, ENTRIES)
    before = {file: file.read_bytes() for file in folder.iterdir()}
    out = tmp_path / f"all.{ending}"
    assert run("table", folder, "-o", out)["rows"] == 3
    if ending == "parquet":
        pandas = pytest.importorskip("pandas")
        rows = pandas.read_parquet(out).astype(object).to_dict("records")
    else:
        rows = list(csv.DictReader(out.open()))
    assert [*rows[0]] == ["part", "evaluation", "seconds", "stage", "objective_mm", "diverged", "x_0", "x_1"]
    assert [row["stage"] for row in rows] == [entry.stage for entry in ENTRIES]
    assert float(rows[0]["objective_mm"]) == pytest.approx(12.3)
    assert str(rows[1]["objective_mm"]) in ("", "nan")  # it diverged
    assert str(rows[2]["x_1"]) in ("", "nan")  # it varied less
    assert {file: file.read_bytes() for file in folder.iterdir()} == before


def test_every_sample_of_a_sweep_is_a_row_with_own_outputs(tmp_path: Path) -> None:
    """More pressure in front lifts the lower corner."""
    study = SensitivityStudy(
        name="lift",
        design=build("vertical", muscles=2),
        varied=(Varied("pressure.0", "pressure", (0,), 0.0, 300.0, "kPa"),),
        joint=False,
        outputs=("height of corner (0, 0.2)",),
        pressures=np.zeros(2),
        methods=("morris",),
        trajectories=4,
    )
    run_sensitivity(study, tmp_path / "sweep", forward=AnalyticCloth(41))
    table = run("table", tmp_path / "sweep", "-o", tmp_path / "samples.csv")
    rows = list(csv.DictReader((tmp_path / "samples.csv").open()))
    assert table["rows"] == len(rows) == 4 * 2
    by_pressure = sorted((float(row["pressure.0"]), float(row["height of corner (0, 0.2) [mm]"])) for row in rows)
    lowest, highest = by_pressure[0], by_pressure[-1]
    assert lowest[0] < highest[0]
    assert lowest[1] < highest[1]
    (listed,) = run("list", tmp_path)["results"]
    assert listed["made_by"] == "sensitivity"


def test_a_search_is_a_store_of_optuna_studies(tmp_path: Path) -> None:
    """A study a part; the best trial is the best evaluation, and what diverged has failed."""
    optuna = pytest.importorskip("optuna", reason="the extra optuna is not installed")
    search_folder(tmp_path / "grid" / "cells" / "one", 4.5, ENTRIES)
    search_folder(tmp_path / "grid" / "cells" / "two", 3.5, ENTRIES[:1])
    assert run("table", tmp_path / "grid", "-o", tmp_path / "all.db")["rows"] == 4
    store = f"sqlite:///{tmp_path / 'all.db'}"
    assert sorted(optuna.get_all_study_names(store)) == ["cells/one", "cells/two"]
    study = optuna.load_study(study_name="cells/one", storage=store)
    assert [trial.state.name for trial in study.trials] == ["COMPLETE", "FAIL", "COMPLETE"]
    assert (study.best_value, study.best_params) == (pytest.approx(4.5), {"x_0": 0.125})
    assert study.trials[1].user_attrs == {"evaluation": 2, "seconds": 0.75, "stage": "coarse model"}
    single = search_folder(tmp_path / "lift", 4.5, ENTRIES)
    run("table", single, "-o", tmp_path / "lift.db")
    assert optuna.get_all_study_names(f"sqlite:///{tmp_path / 'lift.db'}") == ["lift"]
    for name in ("a?b.db", "50%20.db", "a#b c.db"):
        run("table", single, "-o", tmp_path / name)
        file = sqlite3.connect(tmp_path / name)
        assert file.execute("select study_name from studies").fetchall() == [("lift",)]
        file.close()
    assert sorted(path.name for path in tmp_path.glob("*.db")) == sorted(
        ["all.db", "lift.db", "a?b.db", "50%20.db", "a#b c.db"]
    )
    (tmp_path / "sweep").mkdir()
    (tmp_path / "sweep" / "samples.csv").write_text("method,pressure.0\nmorris,1\n")
    with pytest.raises(InputError, match=r"^sweep: has no objective_mm; expected the folder of a search"):
        run("table", tmp_path / "sweep", "-o", tmp_path / "sweep.db")
    assert not (tmp_path / "sweep.db").exists()


def test_what_is_no_result_is_refused_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "plain").mkdir()
    a = search_folder(tmp_path / "a", 4.5, ENTRIES)
    (tmp_path / "damaged").mkdir()
    write_mark(tmp_path / "damaged", "optimize", [])
    (tmp_path / "damaged" / "result.json").write_text("{")
    for words, problem in (
        (("show", tmp_path / "plain"), "is no folder that fabdesign made"),
        (("show", tmp_path / "damaged"), "result.json: cannot be read"),
        (("list", tmp_path / "none"), "no such folder"),
        (("compare", a), "expected two or more"),
        (("table", tmp_path / "plain", "-o", tmp_path / "t.csv"), "expected the folder of a search or of a sweep"),
        (("table", a, "-o", tmp_path / "t.xlsx"), "ends in .csv, .parquet or .db"),
    ):
        with pytest.raises(InputError) as refused:
            run(*words)
        assert problem in str(refused.value)
        assert "\n" not in str(refused.value)
    assert not list(tmp_path.glob("t.*"))
