"""Longer checks of the simulator (`make verify-sim`); their figures become docs/lab/simulator_verification.md."""

import os
import platform
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).parent
TABLE = HERE.parents[1] / "docs" / "lab" / "simulator_verification.md"
_rows: list[tuple[str, str, str, str]] = []  # check, bound, measured, test
_failed: set[str] = set()


def pytest_configure(config):
    config.addinivalue_line("markers", "verify: longer checks of the simulator, run by `make verify-sim`")


def pytest_collection_modifyitems(items):
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.verify)


def pytest_runtest_logreport(report):
    if report.failed:
        _failed.add(report.nodeid)


@pytest.fixture
def record(request):
    """record(check, bound, measured): one row of the table."""

    def row(check: str, bound: str, measured: str) -> None:
        _rows.append((check, bound, measured, request.node.nodeid))

    return row


def pytest_terminal_summary(terminalreporter, exitstatus):
    if not _rows:
        return
    width = max(len(check) for check, *_ in _rows)
    for check, bound, measured, _ in _rows:
        terminalreporter.write_line(f"{check:<{width}}  {bound:>14}  {measured}")
    if os.environ.get("FABDESIGN_VERIFICATION_TABLE"):
        TABLE.write_text(_page(), encoding="utf-8")


def _page() -> str:
    log = ["git", "log", "-1", "--format=%h", "--", "sim"]
    commit = subprocess.run(log, capture_output=True, text=True, cwd=HERE.parents[1], check=False)
    lines = [
        "# Is the simulator right?",
        "",
        "`make verify-sim` writes this page: every figure is of one run. The tests in `tests/verify` hold the",
        "equations behind each row. Rows of a test that failed are bold.",
        "",
        f"Commit of `sim`: {commit.stdout.strip()}. Machine: {platform.machine()}, {os.cpu_count()} cores,",
        f"{platform.system()}, Python {platform.python_version()}.",
        "",
        "| check | bound | measured |",
        "|---|---|---|",
        *(
            f"| {check} | {bound} | {f'**{measured}**' if test in _failed else measured} |"
            for check, bound, measured, test in _rows
        ),
        "",
        "Mirror images are apart by what single precision and a step's tolerance leave.",
    ]
    return "\n".join(lines) + "\n"
