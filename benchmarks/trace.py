"""Does a trace give the right answer? Twelve sets of the synthetic rig with one effect each, 24 without; and three with
several effects each, of which it is said how many were found.

    python -m benchmarks.trace FOLDER              # all of them; those in FOLDER/results.jsonl are not done again
    python -m benchmarks.trace FOLDER lag none_1   # some of them
    python -m benchmarks.trace FOLDER --motions    # the rig's motions alone, which take longest

Sets: benchmarks/trace_sets.py. Goes on where it stood, also within a trace; the row of a set is written when it is
ready. Answers that the data cannot tell apart count as right where the true one is among them. Writes
FOLDER/results.md, and into docs/results/trace.md where --page is given.
"""

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.machine import ROOT, commit, processor
from benchmarks.trace_sets import RIGS, SEVERAL, Rig, make
from fabdesign.measurement_set import read_set
from fabdesign.output import write_text
from studies.sensitivity.result import wilson
from studies.tracing.run import trace_set

PAGE = ROOT / "docs" / "results" / "trace.md"
BEGIN, END = "<!-- table -->", "<!-- end of table -->"

Cells = Callable[[dict[str, Any]], list[str]]  # of a row of results


def examine(rig: Rig, measured: Path, out: Path) -> dict[str, Any]:
    """Trace it, and say whether the answer is right. mm."""
    begin = time.process_time(), time.monotonic()
    outcome = trace_set(read_set(measured), out, inputs=[measured], say=lambda line: print(f"{rig.name}: {line}"))
    found, evidence = outcome.as_json(), outcome.evidence
    names = [effect["name"] for effect in found["effects"]]
    answers = {*names[:1], *found["indistinguishable"]} if names else {found["verdict"]}
    if len(names) > 1 and rig.right == "adequate":
        answers = set()
    return {
        "rig": rig.name,
        "right": rig.right,
        "answer": " + ".join(names) or found["verdict"],
        "indistinguishable": found["indistinguishable"],
        "is_right": rig.right in answers or set(names) == set(rig.right.split(" + ")),
        "before": found["error"]["before"]["held_out"],
        "after": found["error"]["after"]["held_out"],
        "floor": found["error"]["noise_floor"],
        "excess_before": 1e3 * evidence.before,
        "excess_after": 1e3 * evidence.after,
        "black_box": 1e3 * evidence.box_before,
        "cpu_s": time.process_time() - begin[0],
        "wall_s": time.monotonic() - begin[1],
        "commit": commit(PAGE),
    }


def table(rows: list[dict[str, Any]]) -> str:
    """For people; rows in the order of the rigs."""
    by_name = {row["rig"]: row for row in rows}
    lines = [
        "| set | effect put in | answer | not told from | held out, before, after, floor [mm] | excess, before, after"
        " [mm] | left | CPU s, wall s | commit |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [_line(rig, by_name.get(rig.name), _answer, lambda r: [_left(r)]) for rig in RIGS]
    single = [row for row in rows if row["rig"] in {rig.name for rig in RIGS}]
    return "\n".join(
        [*_summary(single), "", *lines, "", *_confusion(single), "", *_several(by_name), "", f"{processor()}.", ""]
    )


def _several(by_name: dict[str, dict[str, Any]]) -> list[str]:
    lines = [
        "| set | effects put in | found of these | beside them | held out, before, after, floor [mm] | excess, before,"
        " after [mm] | CPU s, wall s | commit |",
        "|---|---|---|---|---|---|---|---|",
    ]
    return lines + [_line(rig, by_name.get(rig.name), _found, lambda r: []) for rig in SEVERAL]


def _line(rig: Rig, r: dict[str, Any] | None, answer: Cells, left: Cells) -> str:
    """Of a table: what was put in, `answer`, the errors, `left`, the cost."""
    cells = [f"{rig.name}, *{rig.layout[0]} {rig.layout[1]}*", rig.put_in]
    if r is None:
        return f"| {' | '.join([*cells, 'not run'])} |"
    cells += answer(r)
    cells += [
        f"{r['before']:.2f}, {r['after']:.2f}, {r['floor']:.2f}",
        f"{r['excess_before']:.2f}, {r['excess_after']:.2f}",
    ]
    cells += [*left(r), f"{r['cpu_s']:.0f}, {r['wall_s']:.0f}", r["commit"]]
    return f"| {' | '.join(cells)} |"


def _answer(r: dict[str, Any]) -> list[str]:
    return [f"{'' if r['is_right'] else '**wrong:** '}{r['answer']}", ", ".join(r["indistinguishable"])]


def _found(r: dict[str, Any]) -> list[str]:
    """Of the effects put in, and beside them."""
    true, said = r["right"].split(" + "), r["answer"].split(" + ")
    return [", ".join(n for n in true if n in said), ", ".join(n for n in said if n not in true)]


def _summary(rows: list[dict[str, Any]]) -> list[str]:
    """Right, of those run, with effects and without, with Wilson's interval."""
    said = []
    for name, own in (("With an effect", [r for r in rows if r["right"] != "adequate"]),
                      ("Without", [r for r in rows if r["right"] == "adequate"])):  # fmt: skip
        right = sum(row["is_right"] for row in own)
        low, high = wilson(right, len(own)) if own else (0.0, 1.0)
        said.append(f"{name}: {right} of {len(own)} right (90 %: {low:.0%} to {high:.0%}).")
    shares = [row["excess_after"] / row["excess_before"] for row in rows if row["is_right"] and _effect(row)]
    if shares:
        said.append(f"Excess left where the effect was found: {median(shares):.0%} in the median of {len(shares)}.")
    return [f"{' '.join(said)} {len(RIGS) - len(rows)} of {len(RIGS)} not run. Synthetic rig."]


def _effect(row: dict[str, Any]) -> bool:
    return row["right"] not in ("adequate", "unexplained")


def _left(row: dict[str, Any]) -> str:
    if not _effect(row) or not row["is_right"]:
        return ""
    return f"{row['excess_after'] / row['excess_before']:.0%}"


def _confusion(rows: list[dict[str, Any]]) -> list[str]:
    counts = Counter((row["right"], row["answer"]) for row in rows)
    lines = ["| right | said | sets |", "|---|---|---|"]
    return lines + [f"| {right} | {said} | {n} |" for (right, said), n in sorted(counts.items())]


def _write(rows: list[dict[str, Any]], folder: Path, page: bool) -> None:
    text = table(rows)
    write_text(folder / "results.md", text)
    if page:
        whole = PAGE.read_text(encoding="utf-8")
        head, tail = whole.split(BEGIN)[0], whole.split(END)[1]
        write_text(PAGE, f"{head}{BEGIN}\n{text}{END}{tail}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", help="of sets; all by default")
    parser.add_argument("--motions", action="store_true", help="measure the sets, and trace none")
    parser.add_argument("--page", action="store_true", help="write the table into docs/results/trace.md")
    arguments = parser.parse_args()
    sets, traces = arguments.folder / "sets", arguments.folder / "traces"
    for folder in (sets, traces):
        folder.mkdir(parents=True, exist_ok=True)
    file = arguments.folder / "results.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    for rig in (*RIGS, *SEVERAL):
        if arguments.names and rig.name not in arguments.names:
            continue
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
