"""The devices of docs/lab/compiler.md, each on and off by its environment variable: the same forces, from processes of
their own that share a folder of compiled kernels."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import InputError
from sim.kernels.frontend import HIDDEN_STEPS, SHORT_FRONTEND, wanted

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("devices")


def forces(folder: Path, *off: str) -> tuple[np.ndarray, set[str]]:
    """Forces of a cloth without the devices `off`, and the names of all kernels that are kept then."""
    kept, out = folder / "kernels", folder / "forces.npy"
    subprocess.run(
        [sys.executable, "-m", "tests.compiled", str(out)],
        cwd=ROOT, env=os.environ | dict.fromkeys(off, "0") | {"TI_OFFLINE_CACHE_FILE_PATH": str(kept)},
        check=True, capture_output=True, timeout=300,
    )  # fmt: skip
    return np.load(out), {file.name for file in kept.glob("*.tic")}


@pytest.fixture(scope="module")
def with_all(folder):
    return forces(folder)


def test_taichis_own_frontend_asks_for_the_same_kernels(folder, with_all):
    force, kernels = forces(folder, SHORT_FRONTEND)
    assert np.array_equal(force, with_all[0])
    assert kernels == with_all[1] and kernels


def test_all_off_gives_the_same_forces(folder, with_all):
    # another kernel for each loop whose step is no longer hidden; 1e-6 of the largest force is rounding
    force, kernels = forces(folder, SHORT_FRONTEND, HIDDEN_STEPS)
    assert np.abs(force).max() > 1
    assert np.abs(force - with_all[0]).max() < 1e-6 * np.abs(force).max()
    assert not kernels <= with_all[1]


def test_a_device_is_on_or_off(monkeypatch):
    for name in SHORT_FRONTEND, HIDDEN_STEPS:
        monkeypatch.delenv(name, raising=False)
        assert wanted(name)
        monkeypatch.setenv(name, "0")
        assert not wanted(name)
        monkeypatch.setenv(name, "no")
        with pytest.raises(InputError, match=rf"{name} is 'no'; expected 0 or 1"):
            wanted(name)
