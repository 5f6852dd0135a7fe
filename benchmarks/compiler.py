"""What each device of docs/lab/compiler.md buys here: writes the page's table.

    python -m benchmarks.compiler [--repeats N]

Every figure is CPU time, of all threads, in a process of its own; rows are measured in turn, N times, so that whatever
else runs weighs on all alike. `--only` is such a process: it prints JSON.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.machine import ROOT, commit, processor, write_part
from benchmarks.sim.measure import Figure

PAGE = ROOT / "docs/lab/compiler.md"
COUNT, FRAMES = 16, 18  # motions of 0.3 s


# what is off, and the variable for that
ROWS: dict[str, dict[str, str]] = {
    "both on": {},
    "Taichi's own frontend": {"FABDESIGN_SHORT_FRONTEND": "0"},
    "steps not hidden": {"FABDESIGN_HIDDEN_STEPS": "0"},
}


def worker(out: Path) -> dict[str, float]:
    """CPU seconds from the start of Python to a first frame, of a motion and of a shape at rest, each in a batch; the
    motions go to `out`."""
    from benchmarks.sim.cases import TIMES, reference
    from sim import Simulator

    simulator, cases = Simulator(), reference(COUNT)
    simulator.motions(cases[:1], [np.array([0.05])])
    first = time.process_time()
    motions = simulator.motions(cases, [TIMES[:FRAMES]] * COUNT)
    batch = (time.process_time() - first) / COUNT
    simulator.equilibria(cases[:1])  # its kernels are compiled or loaded
    begin = time.process_time()
    simulator.equilibria(cases)
    shape = (time.process_time() - begin) / COUNT
    np.save(out, np.array(motions))
    return {"first": first, "batch": batch, "shape": shape}


def measure(row: str, folder: Path) -> dict[str, float]:
    kept = folder / row
    out = subprocess.run(
        [sys.executable, "-m", "benchmarks.compiler", "--only", "--out", str(kept) + ".npy"],
        cwd=ROOT, env=os.environ | ROWS[row] | {"TI_OFFLINE_CACHE_FILE_PATH": str(kept)},
        check=True, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    seconds = json.loads(out.stdout.splitlines()[-1])
    print(row, seconds, file=sys.stderr, flush=True)
    return seconds


def table(repeats: int) -> list[str]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cold = [measure(row, folder)["first"] for row in ROWS]
        warm = [[measure(row, folder) for row in ROWS] for _ in range(repeats)]
        motions = [np.load(folder / f"{row}.npy") for row in ROWS]
    lines = ["| | first frame, cold, s | warm, s | a motion, s | a shape, s | apart, mm |", "|---|---|---|---|---|---|"]
    for k, row in enumerate(ROWS):
        first, batch, shape = (Figure("", [run[k][name] for run in warm], "") for name in ("first", "batch", "shape"))
        apart = 1e3 * np.abs(motions[k] - motions[0]).max()
        cells = (
            f"{cold[k]:.1f}",
            spread(first),
            spread(batch),
            spread(shape),
            "same bits" if apart == 0 else f"{apart:.2g}",
        )
        lines.append(f"| {row} | {' | '.join(cells)} |")
    return lines


def spread(figure: Figure) -> str:
    return f"{figure.median:.3g} ({min(figure.values):.3g}..{max(figure.values):.3g})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.only:
        print(json.dumps(worker(given.out)))
        return
    where = f"commit {commit(PAGE)}; {processor()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    write_part(PAGE, "devices", "\n".join([f"`python -m benchmarks.compiler`, {where}:", "", *table(given.repeats)]))


if __name__ == "__main__":
    main()
