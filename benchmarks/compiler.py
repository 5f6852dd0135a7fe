"""What each device of docs/compiler.md buys here: writes the page's table.

    python -m benchmarks.compiler [--repeats N]

Every figure is CPU time, of all threads, in a process of its own; rows are measured in turn, N times, so that whatever
else runs weighs on all alike. `--only ROW` is such a process: it prints JSON.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.machine import ROOT, commit, processor
from benchmarks.sim.measure import Figure

PAGE = ROOT / "docs/compiler.md"
BEGIN, END = "<!-- devices -->", "<!-- /devices -->"
COUNT, FRAMES = 16, 18  # motions of 0.3 s


@dataclass(frozen=True)
class Row:
    name: str
    off: str = ""  # variable
    four: bool = False  # whether LLVM is held to 4 floats


ROWS = (
    Row("all on"),
    Row("LLVM held to 4 floats, as it is on Zen 5 without wide vectors", four=True),
    Row("Taichi's own frontend", "FABDESIGN_SHORT_FRONTEND"),
    Row("steps not hidden", "FABDESIGN_HIDDEN_STEPS"),
)


def worker(row: Row, out: Path) -> dict[str, float]:
    """CPU seconds from the start of Python to a first frame, of a motion and of a shape at rest, each in a batch; the
    motions go to `out`."""
    from benchmarks.sim.cases import TIMES, reference
    from sim import Simulator
    from sim.kernels import vector_width

    if row.four:
        vector_width.known_to_llvm = lambda processor: False
        vector_width.OPTION = b"-slp-max-reg-size=128"
        if not vector_width.widen():
            raise SystemExit("the width cannot be set here")
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


def measure(row: Row, folder: Path) -> dict[str, float]:
    kept = folder / str(ROWS.index(row))
    off = {row.off: "0"} if row.off else {}
    out = subprocess.run(
        [sys.executable, "-m", "benchmarks.compiler", "--only", row.name, "--out", str(kept) + ".npy"],
        cwd=ROOT, env=os.environ | off | {"TI_OFFLINE_CACHE_FILE_PATH": str(kept)},
        check=True, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    found = json.loads(out.stdout.splitlines()[-1])
    print(row.name, found, file=sys.stderr, flush=True)
    return found


def table(repeats: int) -> list[str]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cold = [measure(row, folder)["first"] for row in ROWS]
        warm = [[measure(row, folder) for row in ROWS] for _ in range(repeats)]
        motions = [np.load(folder / f"{k}.npy") for k in range(len(ROWS))]
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
        lines.append(f"| {row.name} | {' | '.join(cells)} |")
    return lines


def spread(figure: Figure) -> str:
    return f"{figure.median:.3g} ({min(figure.values):.3g}..{max(figure.values):.3g})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", choices=[row.name for row in ROWS], help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.only:
        [row] = (row for row in ROWS if row.name == given.only)
        print(json.dumps(worker(row, given.out)))
        return
    where = f"commit {commit(PAGE)}; {processor()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    text = "\n".join([BEGIN, f"`python -m benchmarks.compiler`, {where}:", "", *table(given.repeats), END])
    page = PAGE.read_text(encoding="utf-8")
    before, rest = page.split(BEGIN)
    PAGE.write_text(before + text + rest.split(END)[1], encoding="utf-8")


if __name__ == "__main__":
    main()
