"""Several designs on the virtual rig in one session; its motions, slow, are left out here."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.files.measurement_set import read_set
from fabdesign.nouns.array import Array
from fabdesign.nouns.catalogue import build
from studies.rig import RigSession, run_rig
from studies.rig.specimen import TrialTask, prepare
from tests.command_line import Run
from tests.conftest import ROOT


def test_several_designs_in_one_session(tmp_path: Path, run: Run) -> None:
    """Order counts on from design to design; what follows a design are its pressures."""
    for name in ("vertical", "cross"):
        write_design(build(name), tmp_path / f"{name}.toml")
    key = tmp_path / "key.toml"
    key.write_text('format = "fabdesign.key/1"\n[sensing]\nframe_rate = 20.0\npoints = 300\n')
    paths = {name: tmp_path / f"{name}.csv" for name in ("a", "b", "c")}
    for name, channels in (("a", 3), ("b", 3), ("c", 2)):
        columns = range(channels)
        head = ",".join(["time_s", *(f"channel_{k}" for k in columns)])
        rows = [",".join(map(str, [t, *(0 for _ in columns)])) for t in (0, 0.05)]
        paths[name].write_text("\n".join([head, *rows]) + "\n")
    vertical, cross = tmp_path / "vertical.toml", tmp_path / "cross.toml"
    session = (vertical, paths["a"], paths["b"], cross, paths["c"])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("studies.rig.run.shapes_of", lambda tasks, workers: (still(task) for task in tasks))
        code, _, err = run("rig", *session, "--key", key, "--test-trials", 1, "-o", tmp_path / "set")
    assert code == 0, err
    trials = read_set(tmp_path / "set").trials
    assert [(t.design_name, t.order, t.role) for t in trials] == [
        ("vertical", 0, "fit"),
        ("vertical", 1, "test"),
        ("cross", 2, "test"),
    ]
    code, _, err = run("rig", vertical, paths["a"], cross, "-o", tmp_path / "none")
    assert code == 2 and "cross.toml: no pressures" in err
    with pytest.raises(InputError, match="design vertical: two of this name"):
        run_rig(RigSession([(vertical, [paths["a"]]), (vertical, [paths["b"]])]), tmp_path / "none")
    assert not (tmp_path / "none").exists()


def still(task: TrialTask) -> Array:
    """Control points of the flat cloth at each of a task's times."""
    return np.repeat(prepare(task).patch.flat()[None], len(task.times), axis=0)


def test_a_script_that_is_read_again_is_told_to_guard_its_call(tmp_path: Path) -> None:
    """Each process that computes trials reads the script that asked for them; nothing is left half written."""
    script = tmp_path / "script.py"
    script.write_text('import fabdesign\nfabdesign.rig("cross.toml", ["a.csv", "a.csv"], "set")\n')
    write_design(build("cross", muscles=2), tmp_path / "cross.toml")
    (tmp_path / "a.csv").write_text("time_s,channel_0,channel_1\n0,100,0\n0.05,0,0\n")
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    ended = subprocess.run(
        [sys.executable, script], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120
    )
    assert ended.returncode == 1
    assert (
        "set: its trials are computed by processes that read the script again; in a script, call this" in ended.stderr
    )
    assert ended.stderr.splitlines()[-1].endswith('call this under `if __name__ == "__main__":`')
    assert not (tmp_path / "set").exists()
