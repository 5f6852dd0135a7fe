"""A trace of made benches whose effect is known, by size: writes its part of docs/lab/benches.md.

    python -m benchmarks.made_benches [--page]

Three effects at four sizes (RMS of what the law alone leaves, in the noise of a reading), and two benches without any.
Muscles: 0 to 400 kPa in steps of 50, swept out and back in 16 or 24 readings; strips: stretched within 1 s and held.
Each has three records, noise of 1.2 % of the largest force, and is judged with the default tolerance of 2 % and with
0.5 %.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from benchmarks.machine import ROOT, commit, processor, write_part
from fabdesign.nouns.bench import Bench, BenchRecord, Specimen
from studies.benches.cylinder import friction_state
from studies.benches.trace_report import BenchOutcome
from studies.benches.tracing import examine

PAGE = ROOT / "docs" / "lab" / "benches.md"
SIZES = 0.5, 1.0, 3.0, 6.0  # RMS of the effect, over the noise
NOISE = 0.012  # of the largest force
TOLERANCES = 0.02, 0.005
Array = np.ndarray
Columns = dict[str, Array]


def muscle(readings: int) -> Columns:
    """Return a muscle's quasi-static sweeps without effects or noise: SI, a reading each second."""
    pressure = np.repeat(np.arange(0, 401e3, 50e3), 2 * readings)
    one_way = np.linspace(-0.02, 0.22, readings)
    contraction = np.tile(np.r_[one_way, one_way[::-1]], 9)
    force = 4e-5 * pressure * np.clip(1 - 3 * contraction, 0, None) - 55 * contraction
    force += 200 * np.maximum(-contraction, 0)
    time_s = np.arange(len(pressure), dtype=float)
    return {"time": time_s, "pressure": pressure, "contraction": contraction, "force": force}


def strip() -> Columns:
    """Return a strip's stretch within 1 s and hold, without effects or noise."""
    time_s = np.linspace(0, 20, 400)
    stretch = 1 + 0.3 * np.minimum(time_s, 1)
    return {"time": time_s, "stretch": stretch, "force": 20 * (stretch - 1) + 60 * (stretch - 1) ** 2}


def friction(c: Columns) -> Array:
    """Return braid_hysteresis: friction by pressure, a slip of 0.005."""
    return -c["pressure"] * friction_state(c["contraction"], 0.005)


def viscosity(c: Columns) -> Array:
    """Return muscle_viscosity, the same both ways."""
    return -np.gradient(c["contraction"], c["time"])


def relaxation(c: Columns) -> Array:
    """Return stress_relaxation: a share of the force goes with 6 s."""
    return c["force"] * np.exp(-c["time"] / 6)


CASES: tuple[tuple[str, Columns, Callable[[Columns], Array] | None], ...] = (
    ("braid_hysteresis", muscle(24), friction),
    ("muscle_viscosity", muscle(16), viscosity),
    ("stress_relaxation", strip(), relaxation),
)


def made(columns: Columns, effect: Callable[[Columns], Array] | None, size: float, seed: int) -> tuple[Bench, float]:
    """Return three records with an effect of `size` times the noise, and the noise [N]."""
    rng, sigma = np.random.default_rng(seed), NOISE * float(np.abs(columns["force"]).max())
    shape = np.zeros(len(columns["force"])) if effect is None else effect(columns)
    added = size * sigma * shape / max(float(np.sqrt(np.mean(shape**2))), 1e-30)
    records = []
    for k in range(3):
        force = columns["force"] + added + sigma * rng.standard_normal(len(added))
        records.append(BenchRecord(f"r{k}", {**columns, "force": force}, {}))
    specimen: Specimen = "strip" if "stretch" in columns else "muscle"
    return Bench("made", specimen, (), "force", {}, tuple(records)), sigma


def answer(outcome: BenchOutcome, name: str) -> str:
    """Return the verdict in a cell; what names another effect is marked."""
    names = [effect.name for effect in outcome.effects] if outcome.verdict == "effect" else []
    alike = outcome.indistinguishable if names else ()
    small = f"; {outcome.small.name} certain, within the tolerance" if outcome.small else ""
    wrong = "**wrong:** " if names and name not in (*names, *alike) else ""
    beside = f", or {', '.join(alike)}" if alike else ""
    return f"{wrong}{' + '.join(names) or outcome.verdict}{beside}{small}"


def row(name: str, columns: Columns, effect: Callable[[Columns], Array] | None, size: float, seed: int) -> str:
    """Return a line of the table."""
    bench, sigma = made(columns, effect, size, seed)
    outcomes = [examine(bench, tolerance) for tolerance in TOLERANCES]
    noise, evidence = outcomes[0].noise, outcomes[1].evidence
    put_in = f"{name}, {size:g} x" if effect else f"none ({bench.specimen})"
    cells = [put_in, f"{size * sigma:.2f}", f"{sigma:.3f}", f"{noise.sigma:.3f}, {noise.source}"]
    cells += [f"{evidence.before:.3f}, {evidence.after:.3f}", f"{outcomes[0].tolerance:.2f}"]
    cells += [answer(outcome, name) for outcome in outcomes]
    return f"| {' | '.join(cells)} |"


def table() -> list[str]:
    """Return the twelve benches with an effect and the two without."""
    lines = [
        "| put in, size over the noise | RMS of it, N | noise, N | noise estimated, N | excess before, after, N | "
        "tolerance of 2 %, N | answer at 2 % | answer at 0.5 % |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [row(name, columns, effect, size, 7) for name, columns, effect in CASES for size in SIZES]
    lines += [row("", columns, None, 0.0, 8) for columns in (muscle(24), strip())]
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page", action="store_true", help="write the table into docs/lab/benches.md")
    arguments, start = parser.parse_args(), time.process_time()
    lines = table()
    print("\n".join(lines), flush=True)
    if arguments.page:
        about = (
            "## Made benches: which effect, by size\n\nMade data, no specimen. Command: "
            f"`python -m benchmarks.made_benches --page`. Commit {commit()}; {processor()}; "
            f"{time.process_time() - start:.0f} CPU s.\n"
        )
        write_part(PAGE, "made benches", "\n".join([about, *lines]))


if __name__ == "__main__":
    main()
