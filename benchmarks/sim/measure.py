"""Figures with bounds, and the processes that they are measured in."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.machine import ROOT


@dataclass(frozen=True)
class Figure:
    """One row of a table: repeats of one measurement beside its bound, if it has one."""

    name: str
    values: Sequence[float]
    unit: str
    bound: float | None = None
    at_least: bool = False  # the bound is the least that will do; else the most

    @property
    def median(self) -> float:
        ordered = sorted(self.values)
        return (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2

    @property
    def missed(self) -> bool:
        if self.bound is None:
            return False
        return self.median < self.bound if self.at_least else self.median > self.bound

    def row(self) -> str:
        bound = "" if self.bound is None else f"at {'least' if self.at_least else 'most'} {self.bound:g}{self.unit}"
        value = f"{self.median:.3g}{self.unit}"
        if len(self.values) > 1:
            value += f" ({min(self.values):.3g}..{max(self.values):.3g})"
        cells = (self.name, bound, value)
        return "| " + " | ".join(f"**{cell}**" if self.missed and cell else cell for cell in cells) + " |"


def table(figures: Sequence[Figure]) -> list[str]:
    return ["| figure | bound | median (min..max) |", "|---|---|---|", *(figure.row() for figure in figures), ""]


def work(kind: str, *, lanes: int = 8, **given: int) -> dict[str, Any]:
    """What benchmarks.sim.worker prints, and `taken`: seconds from the start of its process until then."""
    options = [text for name, value in given.items() for text in (f"--{name}", str(value))]
    print(" ".join([kind, *options, f"lanes {lanes}"]), file=sys.stderr, flush=True)
    begin = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, "-m", "benchmarks.sim.worker", kind, *options],
        cwd=ROOT, env={**os.environ, "FABDESIGN_LANES": str(lanes)}, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        line = next((text for text in process.stdout if text.startswith("{")), None)
        taken = time.perf_counter() - begin
    if process.returncode or line is None:
        raise SystemExit(f"benchmarks.sim.worker {kind} ended with {process.returncode}")
    return json.loads(line) | {"taken": taken}
