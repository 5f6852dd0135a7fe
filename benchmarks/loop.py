"""Loops on virtual rigs: error on the device at first, after one and after two turns; six with an effect of the list,
one with wind, which is none, and a network. Writes docs/lab/loop.md.

    python -m benchmarks.loop [--cases 0,1] [--work FOLDER]

Each target is the rig's own shape at rest, measured, of a layout that the loop is not told; each rig has factors and an
effect that no data sheet declares. A case that is done is kept in the folder, one that was stopped goes on.
"""

import argparse
import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import ROOT, commit, processor, write_part
from fabdesign.files.design_file import write_design
from fabdesign.files.measurement_set import read_set
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import rising_program
from fabdesign.output import write_text
from fabdesign.study_files.loop_file import LoopStudy
from optimize.search.margins import Limits, constraint_margins
from studies.loop.run import run_loop

PAGE = ROOT / "docs" / "lab" / "loop.md"
ELEMENT, STEP = 0.0125, 1 / 480  # m, s of the rig: coarser than its own
GRID = 21  # points a side of the search, the trace and the fit
RISE, HOLD = 0.5, 1.5  # s
EVALUATIONS = 2000  # of each search
POINTS = 3362  # of a target
TURNS = 2
ASKED = {1: 0.7, 2: 0.85}  # by turn, of the first design's excess that is to go
NETWORK = 'train = "field"\ntrain_trials = 7\n'


@dataclass(frozen=True)
class LoopCase:
    """A hidden layout with its pressures [kPa], the start, and what the rig is. Paths in m."""

    name: str
    effect: str  # a line of TOML
    factors: str
    start: Design
    hidden: tuple[tuple[str, tuple[tuple[float, float], ...]], ...]
    pressures: tuple[float, ...]
    seed: int = field(default=1)
    network: bool = False  # learned too, from more trials

    @property
    def design(self) -> Design:
        """The hidden one: the start's muscles elsewhere."""
        muscles = tuple(
            replace(muscle, side="front" if side == "front" else "back", path=path)
            for muscle, (side, path) in zip(self.start.muscles, self.hidden, strict=True)
        )
        return replace(self.start, name="hidden", muscles=muscles)


def _on_two_faces(design: Design) -> Design:
    """Every other muscle on the back: on one face none may cross."""
    muscles = [replace(m, side="back") if k % 2 else m for k, m in enumerate(design.muscles)]
    return replace(design, muscles=tuple(muscles))


def _down(u: float, low: float, top: float = 0.01, bottom: float = 0.19) -> tuple[tuple[float, float], ...]:
    return ((u, top), (low, bottom))


CASES = (
    LoopCase("tilt", 'name = "frame_tilt"\nparameters = { about_x = 4.0 }', "bending = 0.85\nmuscle_gain = 0.92",
         build("vertical", muscles=3), (("front", _down(0.05, 0.08)), ("front", _down(0.11, 0.10)),
         ("front", _down(0.15, 0.17))), (260, 120, 300)),
    LoopCase("droop", 'name = "supply_droop"\nparameters = { share = 0.08 }', "bending = 1.15\nmembrane = 0.9",
         build("vertical", muscles=3), (("front", _down(0.03, 0.03)), ("front", _down(0.09, 0.13)),
         ("front", _down(0.17, 0.16))), (320, 260, 180)),
    LoopCase("orthotropy", 'name = "orthotropy"\nparameters = { ratio = 2.0 }', "muscle_gain = 1.08",
         _on_two_faces(build("cross", muscles=2)), (("front", _down(0.03, 0.15)), ("back", _down(0.16, 0.06))),
         (300, 220)),
    LoopCase("line loss", 'name = "line_loss"\nparameters = { share = 0.35 }', "bending = 0.9\nareal_density = 1.1",
         build("vertical", muscles=2), (("front", _down(0.06, 0.05)), ("front", _down(0.13, 0.16))), (330, 240)),
    LoopCase("odd muscle", 'name = "odd_muscle"\nparameters = { channel = 0, factor = 0.7 }', "membrane = 1.15",
         build("vertical", muscles=3), (("front", _down(0.04, 0.06)), ("front", _down(0.10, 0.09)),
         ("front", _down(0.16, 0.14))), (280, 200, 330)),
    LoopCase("hysteresis", 'name = "braid_hysteresis"\nparameters = { friction = 0.006 }', "bending = 1.1\nshear = 0.9",
         _on_two_faces(build("cross", muscles=2)), (("front", _down(0.05, 0.18)), ("back", _down(0.18, 0.09))),
         (340, 280)),
    LoopCase("wind, with a network", 'name = "wind"\nparameters = { z = 0.3 }', "bending = 1.1\nmuscle_gain = 0.95",
         build("vertical", muscles=2), (("front", _down(0.06, 0.04)), ("front", _down(0.14, 0.17))), (300, 260),
         network=True),
)  # fmt: skip


def study_of(case: LoopCase, number: int, folder: Path) -> LoopStudy:
    """The case's study in its folder, which is made with its key and its target, measured on the rig at rest."""
    from studies.rig import RigSession, run_rig
    from studies.rig.scene import Resolution

    pressures = 1e3 * np.array(case.pressures, dtype=float)
    if (least := min(constraint_margins(case.design, pressures[None], Limits()).values())) < 0:
        raise ValueError(f"{case.name}: the hidden layout breaks a limit of every search by {-least:g}")
    folder.mkdir(parents=True, exist_ok=True)
    key, target = folder / "key.toml", folder / "target.npz"
    if not target.is_file():
        write_text(
            key,
            f'format = "fabdesign.key/1"\nseed = {number + 11}\n[parameters]\n{case.factors}\n[[effects]]\n'
            f"{case.effect}\n[sensing]\nframe_rate = 20.0\npoints = 600\n",
        )
        program = rising_program(pressures, RISE, RISE + HOLD)
        session = RigSession([(case.design, [program])], key, resolution=Resolution(element=ELEMENT, step=STEP))
        run_rig(session, folder / "target_set", force=True)
        frames = read_set(folder / "target_set").trials[0].load().frames[-8:]
        points = np.concatenate(frames)
        drawn = np.random.default_rng(number).permutation(len(points))[:POINTS]
        np.savez(target, points=points[drawn])
    write_design(case.start, folder / "start.toml")
    write_text(
        folder / "study.toml",
        f'format = "fabdesign.study/1"\nkind = "loop"\nname = "{case.name}"\ndesign = "start.toml"\n'
        f'seed = {case.seed}\npoints_per_side = {GRID}\nrise = {RISE}\nhold = {HOLD}\n[target]\nfile = "target.npz"\n'
        f"[variables]\npositions = true\n[limits]\nseconds = 3600\nevaluations = {EVALUATIONS}\n"
        f'[rig]\nkey = "key.toml"\nelement = {ELEMENT}\nstep = {STEP:.6f}\n'
        f"[trials]\nnumber = {8 if case.network else 4}\nseconds = 1.0\n[learning]\ntrace_grid = {GRID}\n"
        f"{NETWORK if case.network else ''}[stop]\nturns = {TURNS}\nexcess = 0\ngain = -10\n",
    )
    return LoopStudy.read(folder / "study.toml")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", default=",".join(map(str, range(len(CASES)))), help="Numbers; none: only the page.")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "loop")
    options = parser.parse_args()
    for number in map(int, options.cases.split(",") if options.cases else []):
        case, folder = CASES[number], options.work / str(number)
        print(f"{case.name}", flush=True)
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "commit", commit(PAGE))
        study = study_of(case, number, folder)
        run_loop(study, folder / "out", progress=lambda line, share: print(f"  {share or 0.0:.0%} {line}", flush=True))
        write_part(PAGE, "loop", page(options.work))
    write_part(PAGE, "loop", page(options.work))


def page(work: Path) -> str:
    """Of all cases that are done."""
    rows, missing, commits = [], [], set()
    remaining: dict[int, list[float]] = {turn: [] for turn in ASKED}  # by turn, of the excess of the first design
    for number, case in enumerate(CASES):
        turns = _turns(work / str(number) / "out" / "pieces")
        if len(turns) < TURNS + 1:
            missing.append(f"{case.name} ({len(turns)} of {TURNS + 1} designs measured)")
        if not turns:
            continue
        commits.add((work / str(number) / "commit").read_text(encoding="utf-8"))
        excess = [device["excess"] for _, device, _ in turns]
        cells = [f"{chosen['believed']['excess']:.2f} / **{device['excess']:.2f}**" for chosen, device, _ in turns]
        cells += [""] * (TURNS + 1 - len(turns))
        shares = {turn: excess[turn] / excess[0] for turn in ASKED if turn < len(turns)}
        change = "; ".join(f"{share - 1:+.0%}" for share in shares.values())
        if not case.network:
            for turn, share in shares.items():
                remaining[turn].append(share)
        chamfers = ", ".join(f"{device['chamfer']:.2f}" for _, device, _ in turns)
        verdicts = "; ".join(_verdict(learned) for *_, learned in turns if learned)
        floor = turns[0][1]["chamfer_floor"]
        rows.append(f"| {case.name} | {' | '.join(cells)} | {change} | {chamfers} ({floor:.2f}) | {verdicts} |")
    medians = [
        f"**{np.median(fractions) - 1:+.0%}** in the median of {len(fractions)} after {('one turn', 'two')[turn - 1]} "
        f"(asked: {-ASKED[turn]:+.0%})"
        for turn, fractions in remaining.items()
        if fractions
    ]
    return "\n".join(
        [
            f"`make loop` (`python -m benchmarks.loop`), commit {', '.join(sorted(commits))}, {processor()}.",
            "",
            f"Excess of surface RMS over its floor on the device: {', '.join(medians) or 'nothing run'}.",
            *([f"Not run to the end: {', '.join(missing)}."] if missing else []),
            "",
            "mm of excess, what the search believed / **on the device**:",
            "",
            "| rig | at first | after one turn | after two | after one; two | Chamfer on the device (floor) | traced |",
            "|---|---|---|---|---|---|---|",
            *rows,
            "",
            f"Reduced, so that it runs beside other work: rig with elements of {1e3 * ELEMENT:g} mm and steps of "
            f"1/{1 / STEP:.0f} s, the simulator with {GRID} points a side in search, trace and fit, {EVALUATIONS} "
            "evaluations a search,",
            f"five trials a turn of 1 s ({RISE + HOLD:g} s for the shape itself), no network; with one nine trials,",
            "and the median is without that row.",
        ]
    )


def _turns(pieces: Path) -> list[tuple[Any, Any, Any]]:
    """Of each turn that was measured: what was chosen, the device, and what was learned, None where nothing was."""
    turns = []
    for number in range(TURNS + 1):
        files = [pieces / f"turn_{number}_{name}.json" for name in ("choice", "device", "model")]
        results = [json.loads(f.read_text(encoding="utf-8"))["found"] if f.is_file() else None for f in files]
        if results[1] is None:
            break
        turns.append((results[0], results[1], results[2]))
    return turns


def _verdict(learned: dict[str, Any]) -> str:
    trace = learned["trace"]
    network = ", network" if learned["corrector"] else ""
    if trace is None:
        return f"not traced{network}"
    return (" and ".join(trace["effects"]).replace("_", " ") or str(trace["verdict"])) + network


if __name__ == "__main__":
    main()
