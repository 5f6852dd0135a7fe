"""The benchmark's part of docs/lab/search.md, of the cases that are done."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import processor
from benchmarks.search.baselines import TIMES
from benchmarks.search.parts import cases

Rows = dict[str, dict[str, Any]]
REACHED_RATIO, POSE = 1.1, 1.15  # times the floor, and times what a pose reaches alone


def page(work: Path, *, quick: bool, note: str = "") -> str:
    """What is done in `work`, and what is not."""
    every = [*cases()]
    rows = {
        part: {
            case.name: json.loads(file.read_text(encoding="utf-8"))
            for case in every
            if case.part == part and (file := work / part / f"{case.name}.json").is_file()
        }
        for part in dict.fromkeys(case.part for case in every)
    }
    others = {file.stem: json.loads(file.read_text(encoding="utf-8")) for file in sorted((work / "others").glob("*"))}
    not_run = {part: sum(case.part == part for case in every) - len(part_rows) for part, part_rows in rows.items()}
    commits = sorted({row["commit"] for part_rows in rows.values() for row in part_rows.values()})
    lines = [
        f"`make bench-search`{' with QUICK=1' if quick else ''} (`python -m benchmarks.search`),",
        f"commit {', '.join(commits) or 'none'}, {processor()}.",
        "Seconds are those of the machine as it was; CPU seconds, of all threads, tell more where it was busy.",
        *([note] if note else []),
        "",
        f"Not run: {', '.join(f'{count} of part {part}' for part, count in not_run.items() if count) or 'nothing'}"
        f"{'' if others else '; other searches (--others)'}.",
    ]
    lines += _bounds(rows, others)
    lines += _reach(rows["reach"]) + _grid(rows["grid"]) + _robust(rows["robust"]) + _poses(rows["poses"])
    lines += _model(rows["model"])
    return "\n".join([*lines, *_others(others)])


def _bounds(rows: dict[str, Rows], others: Rows) -> list[str]:
    """A line for every bound: what is known of it."""
    reach, grid, poses = rows["reach"].values(), rows["grid"].values(), rows["poses"].values()
    reached, sparse = _reached_counts(rows["reach"])
    copies = [row for row in rows["robust"].values() if "rig_yield" in row]
    better = [
        row["rig_yield"]["yield"] >= 1.5 * row["rig_nominal"]["yield"]
        and row["rig_yield"]["nominal_mm"] <= 1.1 * row["rig_nominal"]["nominal_mm"]
        for row in copies
    ]
    met = [_met(row) for row in poses]
    ratios = [_slower(row) for row in rows["model"].values()]
    steady = [_monotone(row["cells"]) for row in grid]
    none = "not run"
    lines = [
        ("within 10 % of the floor", "11 of 12", f"{reached} of {len(reach)}"),
        ("of those, at most one muscle over the truth", "10 of 12", f"{sparse} of {reached}"),
        ("times fewer seconds than random search, CMA-ES and TPE", "10", _faster(others) if others else none),
        ("`layouts` monotone, half tube", "3 of 3 seeds", f"{sum(steady)} of {len(steady)}" if steady else none),
        ("robust on the rig: yield higher by half, shape within 10 %", "4 of 4", f"{sum(better)} of {len(better)}"),
        ("two poses, each within 15 % of its own layout", "4 of 4", f"{sum(met)} of {len(met)}"),
        ("time of an evaluation over effects and corrector", "1.5", f"{max(ratios):.2f}" if ratios else none),
    ]
    cells = [f"| {what} | {bound} | {none if value == '0 of 0' else value} |" for what, bound, value in lines]
    return ["", "| figure | bound | found |", "|---|---|---|", *cells]


def _faster(others: Rows) -> str:
    """Median times our seconds, by search; of what did not come there only that it took longer."""
    names = [name for name in next(iter(others.values())) if name != "ours"]
    medians = []
    for name in names:
        taken = [row[name]["seconds"] for row in others.values()]
        ours = [row["ours"]["seconds"] for row in others.values()]
        ratios = [np.inf if t is None else t / o for t, o in zip(taken, ours, strict=True)]
        middle = float(np.median(ratios))
        medians.append(f"{name} {middle:.1f}" if np.isfinite(middle) else f"{name} over {TIMES}")
    return ", ".join(medians)


def _reached_counts(reach: Rows) -> tuple[int, int]:
    """How many targets are within REACHED_RATIO of the floor, and how many of those have at most one muscle over the
    truth."""
    reached = [row for row in reach.values() if row["value_mm"] <= REACHED_RATIO * row["floor_mm"]]
    return len(reached), sum(row["muscles"] <= row["truth"] + 1 for row in reached)


def _met(poses: dict[str, Any]) -> bool:
    """Whether each pose of one layout comes as near as a layout of its own, but for the bound."""
    return all(one <= POSE * alone for one, alone in zip(poses["poses_mm"], poses["alone_mm"], strict=True))


def _monotone(cells: dict[str, list[float]]) -> bool:
    """Whether no more muscles and no second face come out worse (cells: `N_TYPE_SIDES`)."""
    reached = {(int(name.split("_")[0]), name.split("_")[-1]): value for name, (value, _) in cells.items()}
    return all(
        value <= other
        for (count, sides), value in reached.items()
        for (fewer, other_sides), other in reached.items()
        if fewer <= count and (other_sides == sides or sides == "both")
    )


def _given(rows: Rows) -> str:
    """A sentence on the seconds that the searches of a part were given."""
    given = sorted({row["given_s"] for row in rows.values()})
    return f"A search of one target was given {' or '.join(f'{s:g}' for s in given)} s."


def _reach(rows: Rows) -> list[str]:
    if not rows:
        return []
    reached, sparse = _reached_counts(rows)
    lines = ["", "## Targets of 2 to 8 muscles", ""]
    lines.append(f"Within 10 % of the floor: **{reached} of {len(rows)}** (bound 11 of 12). Of those, at most one")
    lines.append(f"muscle more than the truth: **{sparse}** (bound 10 of 12). {_given(rows)}")
    lines += [
        "",
        "| target | Chamfer, mm | floor | muscles | truth | s to 1.2 | seconds | CPU seconds | ended | commit |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, r in rows.items():
        cells = f"{r['value_mm']:.2f} | {r['floor_mm']:.2f} | {r['muscles']} | {r['truth']}"
        seconds = f"{r['near_s']:.0f}" if r.get("near_s") else "not measured" if "near_s" not in r else "never"
        ended = f"{r['wall_s']:.0f} | {r['cpu_s']:.0f} | {r['stop_reason'].split(':')[0]}"
        lines.append(f"| {name} | {cells} | {seconds} | {ended} | {r['commit']} |")
    return lines


def _grid(rows: Rows) -> list[str]:
    if not rows:
        return []
    lines = ["", "## `layouts`: a cloth of 0.30 x 0.18 m bent to a half tube, clamped", ""]
    lines.append("Reached (what the cell's own search came to), mm; seconds given, taken, and of all threads.")
    names = list(next(iter(rows.values()))["cells"])
    lines += ["", f"| | {' | '.join(names)} | given | taken | CPU |", f"|---{'|---' * (len(names) + 3)}|"]
    for name, row in rows.items():
        cells = [f"{row['cells'][key][0]:.1f} ({row['cells'][key][1]:.1f})" for key in names]
        lines.append(
            f"| {name} | {' | '.join(cells)} | {row['seconds']:.0f} | {row['wall_s']:.0f} | {row['cpu_s']:.0f} |"
        )
    return lines


def _robust(rows: Rows) -> list[str]:
    if not rows:
        return []
    lines = ["", "## Copies with scatter", ""]
    lines.append(
        "Of the nominal result and of that chosen for yield: 50 copies on the simulator; copies on the virtual"
    )
    lines.append(
        "rig, in longer steps than the targets were (Chamfer of two measured clouds). A copy counts within the median"
    )
    lines.append(
        "of the nominal result's copies there. Bound: yield higher by half, shape at most 10 % worse. Targets: the"
    )
    lines.append("four of the twelve whose nominal result's copies scatter most on the simulator.")
    lines.append(_given(rows))
    names = ("nominal, mm", "expected", "yield", "tolerance")
    columns = " | ".join(f"{where} {name}" for where in ("simulator:", "rig:") for name in names)
    lines += ["", f"| target | result | muscles | {columns} | copies on the rig |", f"|---|---{'|---' * 10}|"]
    for name, row in rows.items():
        for choose, muscles in zip(("nominal", "yield"), row["muscles"], strict=True):
            on_rig = row.get(f"rig_{choose}")
            cells = _of_copies(row[choose]) + (["not run"] * 5 if on_rig is None else _of_copies(on_rig))
            copies = [] if on_rig is None else [str(on_rig["copies"])]
            lines.append(f"| {name} | {choose} | {muscles} | {' | '.join([*cells, *copies])} |")
    return lines


def _of_copies(row: dict[str, Any]) -> list[str]:
    """Cells: mm as it should be and expected, yield, and the tolerance in mm."""
    lengths = [f"{row[key]:.2f}" for key in ("nominal_mm", "expected_mm")]
    return [*lengths, f"{row['yield']:.0%}", f"{row['tolerance_mm']:.2f}"]


def _model(rows: Rows) -> list[str]:
    if not rows:
        return []
    lines = ["", "## Over effects and a corrector", ""]
    lines.append(
        "The demo's model (trained on `rig_a`) beside the data sheet: seconds of search, evaluations within them"
    )
    lines.append("(derivatives count as one), until each ended by itself. Bound: 1.5 times the time of an evaluation.")
    lines += ["", "| target | data sheet | evaluations | model | evaluations | ratio of seconds an evaluation |"]
    lines.append("|---|---|---|---|---|---|")
    for name, row in rows.items():
        cells = [f"{row[k]['search_s']:.0f} | {row[k]['evaluated']}" for k in ("data_sheet", "model")]
        lines.append(f"| {name} | {' | '.join(cells)} | {_slower(row):.2f} |")
    return lines


def _slower(row: dict[str, Any]) -> float:
    """Times the seconds of an evaluation, with the model."""
    one, other = (row[k]["search_s"] / row[k]["evaluated"] for k in ("data_sheet", "model"))
    return float(other / one)


def _poses(rows: Rows) -> list[str]:
    if not rows:
        return []
    lines = ["", "## Two poses, one layout", "", "Each within 15 % of what its own layout reaches is the bound."]
    lines += [f"{_given(rows)} Two poses together: twice that.", ""]
    lines += ["| target | together, mm | alone | met |", "|---|---|---|---|"]
    for name, row in rows.items():
        pairs = [*zip(row["poses_mm"], row["alone_mm"], strict=True)]
        together, alone = (", ".join(f"{pair[k]:.2f}" for pair in pairs) for k in (0, 1))
        lines.append(f"| {name} | {together} | {alone} | {'yes' if _met(row) else 'no'} |")
    return lines


def _others(rows: Rows) -> list[str]:
    if not rows:
        return []
    lines = [
        "",
        "## Other searches",
        "",
        "Seconds to 1.2 times the floor, each up to five times ours; the others are told the truth's number of",
        "muscles, types and faces, and their compiling is not counted. Bound: 10 times ours in the median, which a",
        "stop at five times cannot show: what did not come there within five times is said as `not`, with its best.",
        "",
    ]
    names = list(next(iter(rows.values())))
    lines += [f"| target | {' | '.join(names)} |", f"|---{'|---' * len(names)}|"]
    for name, row in rows.items():
        cells = [f"{r['seconds']:.0f}" if r["seconds"] else f"not ({r['best_mm']:.1f} mm)" for r in row.values()]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines
