"""The simulator on a scheduler and two workers, processes of their own: a sweep and a search give the bits of one
process whoever is killed in the middle of them; a worker of another version is refused."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fabdesign
from fabdesign.errors import SimulationError
from fabdesign.files.design_file import write_design
from fabdesign.files.pressure_file import constant_program
from fabdesign.runtime.cluster import current, on_cluster
from studies.rig import GroundTruth, RigSession, run_rig
from studies.rig.scene import Resolution
from tests.conftest import ROOT

pytest.importorskip("distributed", reason="the extra cluster is not installed")


@contextmanager
def machines(folder: Path, *code: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler's address and process, and a worker that runs the code of each folder of `code`."""
    folder.mkdir(parents=True)
    scheduler_file = folder / "scheduler.json"

    def started(name: str, *words: str, root: Path = ROOT) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{name}", *words, "--no-dashboard"]
        environment = os.environ | {"PYTHONPATH": str(root), "TI_CPU_MAX_NUM_THREADS": "1"}
        with (folder / "log").open("ab") as log:
            return subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)

    scheduler = started("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(scheduler_file))
    running = [scheduler]
    try:
        while not scheduler_file.exists() or not scheduler_file.read_text().endswith("}"):
            assert scheduler.poll() is None, (folder / "log").read_text()
            time.sleep(0.1)
        address = json.loads(scheduler_file.read_text())["address"]
        running += [started("worker", address, "--nthreads", "1", root=root) for root in code]
        yield address, scheduler
    finally:
        for process in reversed(running):
            process.terminate()
        for process in running:
            process.wait()


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with machines(tmp_path_factory.mktemp("two") / "log", ROOT, ROOT) as (scheduler_address, _):
        yield scheduler_address


def kill_a_worker() -> None:
    cluster = current()
    assert cluster is not None
    os.kill(next(iter(cluster.client.run(os.getpid).values())), signal.SIGKILL)


class InTheMiddle:
    """Progress that does something when it is called the second time. shares: of the work, as it was told."""

    def __init__(self, does: Callable[[], None]) -> None:
        self._does, self.shares = does, list[float | None]()

    def __call__(self, line: str, share: float | None) -> None:
        self.shares.append(share)
        if len(self.shares) == 2:
            self._does()


def swept(out: Path, **options: Any) -> Any:
    return fabdesign.sensitivity(
        fabdesign.build("vertical", muscles=2),
        {"pressure.0": (0, 300), "pressure.1": (0, 300), "bending": (0.8, 1.2)},
        out,
        outputs=["tip", "largest_tension"],
        method="sobol",
        samples=128,
        **options,
    )


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The samples of the sweep on one process."""
    out = tmp_path_factory.mktemp("here")
    swept(out / "out")
    return (out / "out" / "samples.csv").read_bytes()


def test_a_sweep_with_a_worker_killed(address: str, here: bytes, tmp_path: Path) -> None:
    killing = InTheMiddle(kill_a_worker)
    swept(tmp_path / "there", cluster=address, progress=killing)
    assert len(killing.shares) > 2
    assert (tmp_path / "there" / "samples.csv").read_bytes() == here


def test_a_sweep_goes_on_after_its_scheduler_was_lost(here: bytes, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with machines(tmp_path / "lost", ROOT) as (first, scheduler):
        killing = InTheMiddle(scheduler.kill)
        with pytest.raises(SimulationError, match=r"the scheduler is gone; what was finished is kept"):
            swept(out, cluster=first, progress=killing)
    with machines(tmp_path / "again", ROOT) as (second, _):
        going_on = InTheMiddle(lambda: None)
        swept(out, cluster=second, progress=going_on)
    assert going_on.shares[0] == killing.shares[-1] != 0.0
    assert (out / "samples.csv").read_bytes() == here


def test_a_worker_of_another_version_is_refused(tmp_path: Path) -> None:
    """One worker has the code of last month."""
    for package in ("fabdesign", "sim", "studies"):
        shutil.copytree(ROOT / package, tmp_path / "old" / package)
    text = (tmp_path / "old" / "fabdesign" / "version.py").read_text()
    (tmp_path / "old" / "fabdesign" / "version.py").write_text(text.replace(fabdesign.__version__, "0.1.9"))
    with machines(tmp_path / "log", tmp_path / "old") as (address, _):
        from distributed import Client

        with Client(address) as client:
            client.wait_for_workers(1, timeout=60)
        write_design(fabdesign.build("basic"), tmp_path / "basic.toml")
        (tmp_path / "s.toml").write_text(
            'kind = "sensitivity"\ndesign = "basic.toml"\n[parameters.bending]\nlow = 0.9\nhigh = 1.1\n'
        )
        words = ["sensitivity", "s.toml", "-o", "out", "--cluster", address]
        command = [sys.executable, "-m", "fabdesign", *words]
        done = subprocess.run(command, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True)
    line = done.stderr.decode()
    assert done.returncode == 2 and line.count("\n") == 1, line
    assert f"has fabdesign 0.1.9; expected {fabdesign.__version__}, as on this machine" in line
    assert not (tmp_path / "out").exists()


def test_a_search_with_a_worker_killed(address: str, tmp_path: Path) -> None:
    vertical = fabdesign.build("vertical", muscles=2)
    goal = fabdesign.equilibrium(vertical, [180, 120], grid=21).points[0, ::4]
    options: dict[str, Any] = {"model": fabdesign.Model(points_per_side=21), "evaluations": 60, "seconds": 3600}
    here = fabdesign.optimize(vertical, goal, tmp_path / "here", **options)
    killing = InTheMiddle(kill_a_worker)
    there = fabdesign.optimize(vertical, goal, tmp_path / "there", cluster=address, progress=killing, **options)
    assert len(killing.shares) > 2
    assert np.array_equal(here.pressures, there.pressures)
    assert np.array_equal(here.points, there.points)
    for one, other in zip(here.history, there.history, strict=True):
        assert replace(one, seconds=0.0) == replace(other, seconds=0.0)


def test_rig_trials(address: str, tmp_path: Path) -> None:
    programs = [constant_program([kpa * 1e3, 0.0], 0.1) for kpa in (50, 100)]
    design = fabdesign.build("vertical", muscles=2)
    session = RigSession([(design, programs)], GroundTruth(), resolution=Resolution(element=0.05))
    run_rig(session, tmp_path / "here", workers=1)
    with on_cluster(address):
        run_rig(session, tmp_path / "there")
    for trial in ("000.npz", "001.npz"):
        assert (tmp_path / "here/trials" / trial).read_bytes() == (tmp_path / "there/trials" / trial).read_bytes()
