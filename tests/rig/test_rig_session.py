"""Several designs on the virtual rig in one session; its motions, slow, are left out here."""

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
