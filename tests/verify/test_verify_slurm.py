"""Workers as SLURM jobs, as examples/slurm_cluster.py starts them: the bits of one process, also with a job cancelled,
and no job left behind. Needs a SLURM that takes jobs from here, two cores and dask-jobqueue."""

import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import fabdesign
from tests.conftest import ROOT

pytest.importorskip("dask_jobqueue", reason="no dask-jobqueue: pip install dask-jobqueue")
pytestmark = pytest.mark.skipif(shutil.which("sbatch") is None, reason="no sbatch: there is no SLURM")


def jobs() -> list[str]:
    """Numbers of the workers' jobs that run or wait."""
    command = ["squeue", "--me", "--noheader", "--format=%i", "--name=dask-worker"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()


@contextmanager
def slurm_cluster(folder: Path) -> Iterator[str]:
    """The address of a scheduler with two jobs of one core each; jobs write into `folder`."""
    command = [sys.executable, str(ROOT / "examples" / "slurm_cluster.py"), "--jobs", "2", "--cores", "1"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    process = subprocess.Popen(
        [*command, "--memory", "4 GB"], cwd=folder, env=environment, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.wait(60)


def cancel_one(running: list[str]) -> None:
    """Once both jobs have computed for a while."""
    time.sleep(20)
    subprocess.run(["scancel", running[0]], check=True)


def test_a_batch_on_jobs_one_of_which_is_cancelled(tmp_path: Path) -> None:
    cloth = fabdesign.build("vertical", muscles=2)
    rows = np.random.default_rng(1).uniform(0, 300, (64, 2))
    here = fabdesign.equilibrium(cloth, rows, grid=21)
    before = jobs()
    with slurm_cluster(tmp_path) as address:
        end = time.monotonic() + 120
        while len(running := [job for job in jobs() if job not in before]) < 2:
            assert time.monotonic() < end, running
            time.sleep(1)
        killer = threading.Thread(target=cancel_one, args=(running,))
        killer.start()
        there = fabdesign.equilibrium(cloth, rows, grid=21, cluster=address)
        killer.join()
        again = fabdesign.equilibrium(cloth, rows, grid=21, cluster=address)
    for one, two, three in zip(here, there, again, strict=True):
        assert np.array_equal(one.points, two.points)
        assert np.array_equal(one.points, three.points)
    assert not set(jobs()) - set(before)
