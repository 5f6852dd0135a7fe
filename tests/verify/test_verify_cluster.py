"""The simulator on two workers of which one is killed: a sweep and a search give the bits of one process."""

import os
import signal
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fabdesign
from fabdesign.cluster import current, on_cluster
from fabdesign.pressure_file import constant_program
from studies.rig import Key, run_rig
from studies.rig.scene import Resolution
from tests.conftest import ROOT

pytest.importorskip("distributed", reason="the extra cluster is not installed")


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    from distributed import LocalCluster

    sys.path.insert(0, str(ROOT))
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as local:
        yield local.scheduler_address


class Killing:
    """Progress that kills a worker when it is called the second time: in the middle of the work."""

    calls = 0

    def __call__(self, line: str, share: float | None) -> None:
        self.calls += 1
        if self.calls == 2:
            cluster = current()
            assert cluster is not None
            os.kill(next(iter(cluster.client.run(os.getpid).values())), signal.SIGKILL)


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


def test_a_sweep_with_a_worker_killed(address: str, tmp_path: Path) -> None:
    swept(tmp_path / "here")
    killing = Killing()
    swept(tmp_path / "there", cluster=address, progress=killing)
    assert killing.calls > 2
    files = [(tmp_path / place / "samples.csv").read_bytes() for place in ("here", "there")]
    assert files[0] == files[1]


def test_a_search_with_a_worker_killed(address: str, tmp_path: Path) -> None:
    vertical = fabdesign.build("vertical", muscles=2)
    goal = fabdesign.equilibrium(vertical, [180, 120], grid=21).points[0, ::4]
    options: dict[str, Any] = {"model": fabdesign.Model(points_per_side=21), "evaluations": 60, "seconds": 3600}
    here = fabdesign.optimize(vertical, goal, tmp_path / "here", **options)
    there = fabdesign.optimize(vertical, goal, tmp_path / "there", cluster=address, progress=Killing(), **options)
    assert np.array_equal(here.pressures, there.pressures)
    assert np.array_equal(here.found.points, there.found.points)
    for one, other in zip(here.found.history, there.found.history, strict=True):
        assert replace(one, seconds=0.0) == replace(other, seconds=0.0)


def test_rig_trials(address: str, tmp_path: Path) -> None:
    programs = [constant_program([kpa * 1e3, 0.0], 0.1) for kpa in (50, 100)]
    options: dict[str, Any] = {"key": Key(), "resolution": Resolution(element=0.05)}
    design = fabdesign.build("vertical", muscles=2)
    run_rig(design, programs, out=tmp_path / "here", workers=1, **options)
    with on_cluster(address):
        run_rig(design, programs, out=tmp_path / "there", **options)
    for trial in ("000.npz", "001.npz"):
        assert (tmp_path / "here/trials" / trial).read_bytes() == (tmp_path / "there/trials" / trial).read_bytes()
