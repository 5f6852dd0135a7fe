"""What all tests share: the measured data where they are there, and a line about compiled kernels."""

import gc
import os
import sys
from pathlib import Path

# beside a busy core, waiting threads that spin cost ten times what the work does; read where NumPy is loaded
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import HealthCheck, settings

from tests.command_line import folder, hanging, run  # noqa: F401 fixtures

# how long an example takes says how busy the machine is, not whether the code is right
settings.register_profile("shared", deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("shared")

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of measured data: FABDESIGN_DATA, or shared/data beside the repository; skips where it is absent."""
    there = Path(os.environ.get("FABDESIGN_DATA", ROOT.parent / "shared" / "data"))
    if not (there / "rig_a" / "set.toml").is_file():
        pytest.skip(f"no measured data at {there}; set FABDESIGN_DATA")
    return there


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest test: at the end one worker would wait for the other that has it."""
    items.sort(key=lambda item: item.path.name != "test_tutorial.py")


def pytest_collection_finish() -> None:
    """What is loaded now stays: no collection of garbage need look at it again."""
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    wall = getattr(sys.modules.get("fabdesign.runtime.working_time"), "wall", None)
    if wall is not None:
        terminalreporter.write_line(f"kernels compiled in {wall.excluded:.1f} s")
