"""What all tests share: the measured data where they are there, and a line about compiled kernels."""

import os
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# how long an example takes says how busy the machine is, not whether the code is right
settings.register_profile("shared", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("shared")

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of measured data: FABDESIGN_DATA, or shared/data beside the repository; skips where it is absent."""
    folder = Path(os.environ.get("FABDESIGN_DATA", ROOT.parent / "shared" / "data"))
    if not (folder / "rig_a" / "set.toml").is_file():
        pytest.skip(f"no measured data at {folder}; set FABDESIGN_DATA")
    return folder


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    seconds = getattr(sys.modules.get("sim.kernels.fields"), "compile_seconds", None)
    if seconds is not None:
        terminalreporter.write_line(f"kernels compiled in {seconds():.1f} s")
