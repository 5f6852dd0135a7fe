"""Do the runs that a trace proposes settle what it left undecided?

    python -m benchmarks.proposed_runs FOLDER [NAME ...] -o TABLE.md

Of sets with an effect (`benchmarks/trace_sets.py`), the first three trials alone. A trace of these; where it cannot
tell its answer from another, says unexplained, or is wrong, the run that it proposes is measured on the same rig and
added, and all is traced again, twice at most. Undecided is whatever is not the right name alone. Goes on where it
stood.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import commit
from benchmarks.trace_sets import RIGS, Rig, make, measure
from fabdesign.files.measurement_set import NewTrial, read_set, write_set
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.output import write_text
from fabdesign.units import from_kpa
from studies.tracing.run import trace_set

FIRST, MOST = 3, 2  # trials; runs proposed


def traced(folder: Path, rig: Rig, measured: MeasurementSet, runs: int) -> dict[str, Any]:
    """`trace.json` of the set with so many runs added; kept."""
    file = folder / "traces" / f"{rig.name}_{runs}" / "trace.json"
    if not file.is_file():
        file.parent.parent.mkdir(parents=True, exist_ok=True)
        say = f"{rig.name} and {runs} runs"
        trace_set(measured, file.parent, inputs=[], say=lambda line: print(f"{say}: {line}", flush=True))
    trace: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return trace


def with_run(folder: Path, rig: Rig, measured: MeasurementSet, trace: dict[str, Any], runs: int) -> MeasurementSet:
    """The set with the proposed run measured; kept."""
    run_folder, set_folder = folder / "runs" / f"{rig.name}_{runs}", folder / "sets" / f"{rig.name}_{runs}"
    if not (set_folder / "set.toml").is_file():
        proposal = trace["next_experiment"]["program"]
        pressure = from_kpa(np.array(proposal["pressure_kpa"]))
        program = PressureProgram(np.array(proposal["time_s"]), pressure, float(proposal["duration_s"]))
        measure(rig, [program], run_folder)
        (run,) = read_set(run_folder).trials
        write(
            set_folder, measured, [*trials(measured), NewTrial(f"run{runs}", rig.name, 100 + runs, "fit", run.load())]
        )
    return read_set(set_folder)


def trials(measured: MeasurementSet) -> list[NewTrial]:
    return [NewTrial(t.name, t.design_name, t.order, t.role, t.load()) for t in measured.trials]


def write(folder: Path, measured: MeasurementSet, several: list[NewTrial]) -> None:
    design = measured.trials[0].design
    several = [replace(trial, design_name=design.name) for trial in several]
    write_set(folder, {design.name: design}, several, name=folder.name, description=measured.description)


def settled(rig: Rig, trace: dict[str, Any]) -> bool:
    """Whether it names what was put in, and no other."""
    return [effect["name"] for effect in trace["effects"]] == [rig.right] and not trace["indistinguishable"]


def examined(folder: Path, rig: Rig) -> list[dict[str, Any]]:
    """The traces of a rig's set, with 0, 1 and 2 runs added as far as they are needed."""
    made = folder / "sets" / rig.name
    if not (made / "set.toml").is_file():
        make(rig, made)
    measured = read_set(made)
    measured = replace(measured, trials=measured.trials[:FIRST])
    traces = [traced(folder, rig, measured, 0)]
    while not settled(rig, traces[-1]) and len(traces) <= MOST and traces[-1]["next_experiment"] is not None:
        measured = with_run(folder, rig, measured, traces[-1], len(traces))
        traces.append(traced(folder, rig, measured, len(traces)))
    return traces


def table(rows: dict[str, list[dict[str, Any]]]) -> str:
    lines = ["| set | put in | three trials | with one run | with two |", "|---|---|---|---|---|"]
    rigs = {rig.name: rig for rig in RIGS}
    for name, traces in rows.items():
        cells = [_shown(one) for one in traces] + [""] * (MOST + 1 - len(traces))
        lines.append(f"| {name} | {rigs[name].put_in} | {' | '.join(cells)} |")
    open_ones = {name: traces for name, traces in rows.items() if not settled(rigs[name], traces[0])}
    done = sum(settled(rigs[name], traces[-1]) for name, traces in open_ones.items())
    lines += ["", f"Undecided with three trials: {len(open_ones)} of {len(rows)}; settled by at most two runs: {done}."]
    return "\n".join([*lines, "", f"Commit {commit()}.", ""])


def _shown(trace: dict[str, Any]) -> str:
    names = " + ".join(effect["name"] for effect in trace["effects"]) or trace["verdict"]
    also = f", not told from {', '.join(trace['indistinguishable'])}" if trace["indistinguishable"] else ""
    program = trace["next_experiment"] and trace["next_experiment"]["program"]["what"]
    return f"{names}{also}" + (f"; proposed: {program}" if program else "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", help="of sets with an effect of the list; all by default")
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    rigs = [rig for rig in RIGS if rig.kind == "one"]
    rows = {}
    for rig in rigs:
        if not options.names or rig.name in options.names:
            rows[rig.name] = examined(options.folder, rig)
            write_text(options.output, table(rows))
    print(table(rows))


if __name__ == "__main__":
    main()
