"""The benchmark's part of docs/results/simulator.md."""

import os
import platform
import subprocess
from pathlib import Path

from benchmarks.sim.measure import ROOT

PAGE = ROOT / "docs/results/simulator.md"
BEGIN, END = "<!-- bench-sim -->", "<!-- /bench-sim -->"


def replaced(text: str, part: str) -> str:
    """`text` with `part` between the markers, and nothing else changed."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise SystemExit(f"{PAGE}: no {BEGIN} ... {END}")
    return f"{before}{BEGIN}\n{part.strip()}\n{END}{after}"


def heading(command: str) -> list[str]:
    """What was run, of which commit, where."""
    return [
        f"`{command}`, {_commit()}; {platform.system()} {platform.machine()}, {_processor()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}. Bold: misses its bound.",
        "",
    ]


def _commit() -> str:
    git = ("git", "-C", str(ROOT))
    try:
        commit = subprocess.run((*git, "rev-parse", "--short", "HEAD"), capture_output=True, text=True, check=True)
        changed = subprocess.run(
            (*git, "status", "--porcelain", "--untracked-files=no", "--", ".", f":!{PAGE.relative_to(ROOT)}"),
            capture_output=True, text=True, check=True,
        )  # fmt: skip
    except (OSError, subprocess.CalledProcessError):
        return "commit unknown"
    return f"commit {commit.stdout.strip()}" + (" with changes" if changed.stdout.strip() else "")


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or "processor unknown"
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "processor unknown")
