"""A search with an empty kernel folder is the one with a full folder: evaluations, result, bits."""

import json
import os
import sqlite3
import subprocess
import sys
from pathlib import Path

from tests.conftest import ROOT

SECONDS = 300  # of search at most, on the busiest machine: evaluations end it
SEARCH = """
import sys
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from fabdesign import working_time
from fabdesign.study_files.study_file import StudyLimits
from studies.demo.run import TARGET, demo_studies
from studies.layouts.run import run_study

basic = demo_studies(Path(str(files("fabdesign") / "data" / TARGET)))[0]
run_study(replace(basic, limits=StudyLimits(seconds=float(sys.argv[2]), evaluations=40)), Path(sys.argv[1]))
print(working_time.wall.excluded)
"""


def test_a_search_with_an_empty_kernel_folder_is_the_one_with_a_full_folder(tmp_path: Path) -> None:
    folders = {"TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path / "taichi"), "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    results, histories, compiled = [], [], []
    for name in ("empty", "full"):
        command = [sys.executable, "-c", SEARCH, str(tmp_path / name), str(SECONDS)]
        ended = subprocess.run(command, cwd=ROOT, env=os.environ | folders, capture_output=True, text=True, check=True)
        assert ("compiling the simulator" in ended.stderr) == (name == "empty"), ended.stderr
        compiled.append(float(ended.stdout))
        result = json.loads((tmp_path / name / "result.json").read_text())
        if name == "empty":
            assert result["wall_s"] < compiled[0]  # it would be more, were compiling counted
        result["wall_s"] = 0.0
        result["reach"]["needs"].pop("seconds")
        result["reach"].pop("said")
        results.append(result)
        with sqlite3.connect(tmp_path / name / "history.sqlite") as file:
            histories.append(file.execute("select stage, objective, x from evaluations order by number").fetchall())
    assert len(histories[0]) == 40 and histories[0] == histories[1]
    assert results[0] == results[1]
    assert compiled[0] > 2 * compiled[1]
