"""The benchmark's part of docs/lab/simulator.md."""

import os
import platform

from benchmarks.machine import ROOT, commit, processor

PAGE = ROOT / "docs/lab/simulator.md"
PART = "bench-sim"


def heading(command: str) -> list[str]:
    """What was run, of which commit, where."""
    return [
        f"`{command}`, commit {commit(PAGE)}; {platform.system()} {platform.machine()}, {processor()}, "
        f"{os.cpu_count()} cores, Python {platform.python_version()}. Bold: misses its bound.",
        "",
    ]
