"""The search on targets of the virtual rig. Writes its part of docs/lab/search.md.

    python -m benchmarks.search [--parts reach,grid,robust,poses,model] [--cases NAME,...] [--work FOLDER]
        [--seconds S] [--processor-seconds] [--others]

A case that is done is kept in the folder, so that the same command goes on. QUICK=1: two cases a part, a quarter of the
seconds. --seconds: of a search, in place of 60, where the machine is not free; all others by the same factor.
--processor-seconds: every limit counts seconds of processors, of all threads together, where other work shares the
machine: TI_NUM_THREADS=1 and --seconds 120 are a minute of two cores. --others: random search, and CMA-ES and TPE where
`cma` and `optuna` are installed, on up to six targets that are done; each ends at 1.2 times the floor, or after five
times the seconds that ours took to there.
"""

import argparse
import json
import os
import time
from pathlib import Path
from unittest.mock import patch

from benchmarks.machine import ROOT, commit, write_part
from benchmarks.search.baselines import baselines
from benchmarks.search.page import page
from benchmarks.search.parts import SECONDS, TIMED_RATIO, cases
from benchmarks.search.targets import truths
from fabdesign.output import write_text

PAGE = ROOT / "docs" / "lab" / "search.md"
PARTS = ("reach", "grid", "robust", "poses", "model")
QUICK, SHARE = 2, 0.25  # cases a part, and of their seconds, with QUICK=1
COMPARED = 6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default=",".join(PARTS), help="Some of them; none: only the page.")
    parser.add_argument("--cases", default="", help="Some of them, by their names; absent: all.")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "search")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="Of a search.")
    parser.add_argument("--processor-seconds", action="store_true", help="Limits count the processors' seconds.")
    parser.add_argument("--note", default="", help="A sentence for the page, of the machine.")
    parser.add_argument("--others", action="store_true", help="Other searches too.")
    options = parser.parse_args()
    if options.processor_seconds:  # what the search's limits go by
        patch.object(time, "monotonic", time.process_time).start()
    quick = os.environ.get("QUICK") == "1"
    work = options.work / "quick" if quick else options.work
    share = (SHARE if quick else 1.0) * options.seconds / SECONDS
    done: dict[str, int] = dict.fromkeys(PARTS, 0)
    named = options.cases.split(",") if options.cases else [case.name for case in cases()]
    for case in cases():
        chosen = case.part in options.parts.split(",") and case.name in named
        if not chosen or (quick and done[case.part] >= QUICK):
            continue
        done[case.part] += 1
        file = work / case.part / f"{case.name}.json"
        if file.is_file():
            continue
        print(f"{case.part}: {case.name}", flush=True)
        folder = work / case.part / case.name
        folder.mkdir(parents=True, exist_ok=True)
        row = case.run(folder, share) | {"commit": commit(PAGE), "given_s": share * SECONDS}
        write_text(file, json.dumps(row, indent=2) + "\n")
        write_part(PAGE, "search", page(work, quick=quick, note=options.note))
    if options.others:
        _others(work, named)
    write_part(PAGE, "search", page(work, quick=quick, note=options.note))


def _others(work: Path, named: list[str]) -> None:
    """Of the targets that our search has come near to in this folder."""
    for truth in truths():
        file, ours = work / "others" / f"{truth.name}.json", work / "reach" / f"{truth.name}.json"
        if truth.name not in named or file.is_file() or not ours.is_file():
            continue
        row = json.loads(ours.read_text(encoding="utf-8"))
        if row.get("near_s") and len([*file.parent.glob("*")]) < COMPARED:
            print(f"others: {truth.name}", flush=True)
            results = baselines(truth, work / "reach" / truth.name, row["near_s"], 1e-3 * TIMED_RATIO * row["floor_mm"])
            write_text(file, json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
