"""Does a trace give the right answer? On sets of the virtual rig whose effects are known (benchmarks/trace_sets.py).

    python -m benchmarks.trace FOLDER              # all of them; those in FOLDER/results.jsonl are not done again
    python -m benchmarks.trace FOLDER none_0 wind_2   # some of them, in this order; --quick: six
    python -m benchmarks.trace FOLDER --motions    # the rig's motions alone

Goes on where it stood, also within a trace; the row of a set is written when it is ready. An answer that the data
cannot tell from the true one counts as right. Writes FOLDER/results.md, and into docs/lab/trace.md where --page is
given.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from benchmarks.machine import ROOT, commit, processor, write_part
from benchmarks.trace_sets import QUICK, RIGS, Rig, make
from fabdesign.effects import EFFECTS
from fabdesign.files.measurement_set import read_set
from fabdesign.nouns.model import Model
from fabdesign.output import write_text
from studies.tracing.run import trace_set

PAGE = ROOT / "docs" / "lab" / "trace.md"

SIZES = (0.0, "under the tolerance"), (0.5, "0.5 to 1 mm"), (1.0, "1 to 2.5 mm"), (2.5, "2.5 mm or more")  # of excess


def examine(rig: Rig, measured: Path, out: Path) -> dict[str, Any]:
    """Trace it, and say whether the answer is right. mm."""
    begin = time.process_time(), time.monotonic()
    with withheld(rig.withheld):
        outcome = trace_set(read_set(measured), out, inputs=[measured], say=lambda line: print(f"{rig.name}: {line}"))
    trace, evidence = outcome.to_json(), outcome.evidence
    names = [effect["name"] for effect in trace["effects"]]
    is_right = rig.is_right(names, trace["verdict"], trace["indistinguishable"])
    return {
        "rig": rig.name,
        "answer": " + ".join(names) or trace["verdict"],
        "discovered": trace["discovered"] and trace["discovered"]["formula"],
        "follows": outcome.remains.follows,
        "drift": 1e3 * outcome.remains.drift,
        "indistinguishable": trace["indistinguishable"],
        "is_right": is_right,
        "wrong_names": [n for n in names if not is_right and n not in rig.right.split(" + ")],
        "decoys": trace["decoys"],
        "below_tenth": trace["weights"]["share_below_tenth"],
        "factors": factors_inside(rig, outcome.model),
        "before": trace["error"]["before"]["held_out"],
        "after": trace["error"]["after"]["held_out"],
        "floor": trace["error"]["noise_floor"],
        "excess_before": 1e3 * evidence.before,
        "excess_after": 1e3 * evidence.after,
        "cpu_s": time.process_time() - begin[0],
        "wall_s": time.monotonic() - begin[1],
        "commit": commit(PAGE),
    }


@contextmanager
def withheld(name: str | None) -> Iterator[None]:
    """An effect that no fit is told of; what moves a cloth to see how stable it is still has it."""
    effects = dict(EFFECTS)
    if name:
        EFFECTS[name] = replace(EFFECTS[name], named=False)
    try:
        yield
    finally:
        EFFECTS.update(effects)


def factors_inside(rig: Rig, model: Model) -> int:
    """Of the seven true factors, those inside their 90 % intervals."""
    count = 0
    for name, truth in rig.factors.items():
        between = model.parameters[name].interval90
        count += between is not None and between[0] <= truth <= between[1]
    return count


KINDS = {
    "one": "one effect of the list",
    "none": "none",
    "several": "several at once",
    "outside": "outside the list",
    "withheld": "withheld from the list",
    "drift": "a drift outside the list",
    "held": "levels held: none, one, several, outside",
}


def table(rows: Sequence[dict[str, Any]]) -> str:
    """For people: counts by kind with Wilson's interval, then a row each of those run."""
    by_name = {row["rig"]: row for row in rows}
    lines = ["| sets with | run | right (90 %) | with a wrong name | decoys called missing |", "|---|---|---|---|---|"]
    for kind, title in KINDS.items():
        every = [rig for rig in RIGS if rig.kind == kind]
        lines.append(_counted(title, len(every), [by_name[rig.name] for rig in every if rig.name in by_name]))
    run = [(rig, by_name[rig.name]) for rig in RIGS if rig.name in by_name]
    lines += ["", *_by_size([row for rig, row in run if rig.kind == "one"])]
    factors = [row["factors"] for rig, row in run if rig.kind != "none" or row["is_right"]]
    lines += [f"True factors inside their 90 % intervals: {sum(factors)} of {7 * len(factors)}.", ""]
    remains = [row["excess_after"] / row["excess_before"] for _, row in run if row["is_right"] and row["decoys"]]
    if remains:
        lines += [f"Excess that what was found leaves of trials left out: {np.median(remains):.0%} in the median.", ""]
    lines += [
        "| set | put in | answer | not told from | role test, before, after, floor [mm] | excess, before, after [mm] "
        "| factors inside, of 7 | CPU s, wall s | commit |",
        "|---" * 9 + "|",
    ]
    return "\n".join([*lines, *(_line(rig, row) for rig, row in run), "", f"{processor()}. Virtual rig.", ""])


def _counted(title: str, count: int, rows: Sequence[dict[str, Any]]) -> str:
    right, wrong = sum(r["is_right"] for r in rows), sum(bool(r["wrong_names"]) for r in rows)
    decoys = [r["decoys"] for r in rows if r["decoys"]]
    taken = f"{sum(d['taken'] for d in decoys)} of {sum(d['tried'] for d in decoys)}" if decoys else ""
    return f"| {title} | {len(rows)} of {count} | {right} ({_between(right, len(rows))}) | {wrong} | {taken} |"


def _between(right: int, count: int) -> str:
    """90 %, of none nothing."""
    return "{:.0%} to {:.0%}".format(*binomtest(right, count).proportion_ci(0.9, method="wilson")) if count else ""


def _by_size(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Of one effect, by the excess that the declared parameters leave without it."""
    lines = ["| one effect leaves, after the declared parameters were fitted | run | named | adequate | other |"]
    lines.append("|---" * 5 + "|")
    for (least, title), most in zip(SIZES, [*(size for size, _ in SIZES[1:]), np.inf], strict=True):
        of_size = [row for row in rows if least <= row["excess_before"] < most]
        named = sum(row["is_right"] for row in of_size)
        adequate = sum(row["answer"] == "adequate" for row in of_size)
        between = f" ({_between(named, len(of_size))})" if of_size else ""
        lines.append(
            f"| {title} | {len(of_size)} | {named}{between} | {adequate} | {len(of_size) - named - adequate} |"
        )
    return [*lines, ""]


def _line(rig: Rig, r: dict[str, Any]) -> str:
    """What was put in, the answer, the errors, the cost."""
    answer = f"{'' if r['is_right'] else '**wrong:** '}{r['answer']}"
    cells = [f"{rig.name}, *{rig.layout[0]} {rig.layout[1]}*", rig.put_in]
    cells += [f"{answer}; {r['discovered']}" if r["discovered"] else answer, ", ".join(r["indistinguishable"])]
    cells += [
        f"{r['before']:.2f}, {r['after']:.2f}, {r['floor']:.2f}",
        f"{r['excess_before']:.2f}, {r['excess_after']:.2f}",
    ]
    cells += [str(r["factors"]), f"{r['cpu_s']:.0f}, {r['wall_s']:.0f}", r["commit"]]
    return f"| {' | '.join(cells)} |"


def _write(rows: list[dict[str, Any]], folder: Path, page: bool) -> None:
    text = table(rows)
    write_text(folder / "results.md", text)
    if page:
        write_part(PAGE, "table", text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", help="of sets; all by default")
    parser.add_argument("--quick", action="store_true", help=f"these alone: {', '.join(QUICK)}")
    parser.add_argument("--motions", action="store_true", help="measure the sets, and trace none")
    parser.add_argument("--page", action="store_true", help="write the table into docs/lab/trace.md")
    arguments = parser.parse_args()
    sets, traces = arguments.folder / "sets", arguments.folder / "traces"
    for folder in (sets, traces):
        folder.mkdir(parents=True, exist_ok=True)
    file = arguments.folder / "results.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    known = {rig.name: rig for rig in RIGS}
    for name in arguments.names or (QUICK if arguments.quick else known):
        rig = known[name]
        if not (sets / rig.name / "set.toml").is_file():
            make(rig, sets / rig.name)
        if arguments.motions or rig.name in {row["rig"] for row in rows}:
            continue
        rows.append(examine(rig, sets / rig.name, traces / rig.name))
        with file.open("a") as stream:
            stream.write(json.dumps(rows[-1]) + "\n")
        _write(rows, arguments.folder, arguments.page)
    _write(rows, arguments.folder, arguments.page)
    print(table(rows), flush=True)


if __name__ == "__main__":
    main()
