"""The benchmark's part of docs/lab/simulator.md."""

import os
import platform

from benchmarks.machine import ROOT, commit, processor

PAGE = ROOT / "docs/lab/simulator.md"
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
        f"`{command}`, commit {commit(PAGE)}; {platform.system()} {platform.machine()}, {processor()}, "
        f"{os.cpu_count()} cores, Python {platform.python_version()}. Bold: misses its bound.",
        "",
    ]
