"""The parts of the benchmark: each measures, and returns lines of Markdown."""

from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from benchmarks.sim.cases import FRAMES
from benchmarks.sim.measure import Figure, table, work


@dataclass(frozen=True)
class Size:
    """How much is measured."""

    frames: int
    repeats: int
    batch: int  # designs
    designs: tuple[int, ...]
    points: tuple[int, ...]


FULL = Size(FRAMES, 3, 32, (1, 8, 32, 128, 1024), (21, 41, 81, 161))
QUICK = Size(4, 1, 8, (1, 8), (21, 41, 81))
GIGABYTE = 1e9


def _each(values: list[float], count: int) -> list[float]:
    return [value / count for value in values]


def speed(size: Size) -> list[str]:
    """A motion, in a batch and alone, and an equilibrium."""
    given = {"frames": size.frames, "repeats": size.repeats}
    figures = []
    for points in (41, 21):
        bounds = (0.4, 3.0, 0.1) if points == 41 else (None, None, None)
        batch = work("motions", points=points, count=size.batch, **given)
        alone = work("motions", points=points, count=1, lanes=2, **given)
        rest = work("equilibria", points=points, count=size.batch, repeats=size.repeats)
        many = f"{points} points a side, {size.batch} designs"
        figures += [
            Figure(f"{many}: CPU a motion", _each(batch["cpu"], size.batch), " s", bounds[0]),
            Figure(f"{many}: by the clock, all", batch["wall"], " s"),
            Figure(f"{points} points a side, one design, lanes of 2: by the clock", alone["wall"], " s", bounds[1]),
            Figure(f"{many}: CPU an equilibrium", _each(rest["cpu"], size.batch), " s", bounds[2]),
        ]
    return [
        f"*Basic*, 4 muscles, {size.frames} frames at 60 Hz, pressures of 0-400 kPa at random from 0, 0.25 and 0.75 s, "
        "default setting, the rest at zero pressure before included, loaded kernels:",
        "",
        *table(figures),
        "CUDA is not built: the same kernels run on the CPU everywhere.",
        "",
    ]


def flex(size: Size) -> list[str]:
    """Beside MuJoCo's flex."""
    lines = ["Newton's cloth: " + ("no comparison is written." if find_spec("newton") else "not installed."), ""]
    if find_spec("mujoco") is None:
        return ["MuJoCo's flex: skipped, the package mujoco is not installed (extra `bench`).", "", *lines]
    for points in (41, 21):
        lines += _beside_flex(size, points)
    return lines


def _beside_flex(size: Size, points: int) -> list[str]:
    given = {"points": points, "frames": size.frames, "repeats": size.repeats}
    batch, alone = work("motions", count=size.batch, **given), work("motions", count=1, lanes=2, **given)
    error = work("error", points=points, count=8, frames=size.frames)
    theirs = work("flex", **given)
    ours = Figure("", _each(batch["cpu"], size.batch), ""), Figure("", alone["cpu"], "")
    figures = []
    lines = [
        f"{points} x {points}, CPU s a motion and RMS error over nodes and frames against the engine's own limit "
        f"(ours: steps of 1/7680 s, 30 iterations, tolerance 3e-8 m; MuJoCo {theirs['version']}: {theirs['limit']} "
        "substeps a frame; MuJoCo has no batch):",
        "",
        "| engine | CPU s | error, mm |",
        "|---|---|---|",
        f"| ours, {size.batch} designs | {ours[0].median:.2f} | {1e3 * error['rms'][0]:.3f} |",
        f"| ours, one design, lanes of 2 | {ours[1].median:.2f} | {1e3 * error['rms'][0]:.3f} |",
    ]
    for substeps, row in theirs["rows"].items():
        cpu = Figure("", row["cpu"], "")
        lines.append(f"| MuJoCo, {substeps} substeps | {cpu.median:.2f} | {1e3 * row['rms']:.3f} |")
        larger = "at no larger error" if error["rms"][0] <= row["rms"] else "but at a larger error"
        figures += [
            Figure(f"{points} x {points}, MuJoCo with {substeps} substeps over ours, {who}, {larger}",
                   [t / one.median for t in row["cpu"]], "", bound, at_least=True)
            for who, one, bound in (("batch", ours[0], 20.0), ("one design", ours[1], None))
        ]  # fmt: skip
    unfinished = " and ".join(f"{row['unfinished']:.0%}" for row in theirs["rows"].values())
    return [
        *lines,
        "",
        f"Ours of 8 motions: median {1e3 * np.median(error['rms']):.3f}, worst {1e3 * max(error['rms']):.3f} mm. Nodes "
        f"move {1e3 * error['moved']:.1f} mm RMS from rest in ours, {1e3 * theirs['moved']:.1f} mm in MuJoCo; the two "
        f"limits are {1e3 * theirs['apart']:.1f} mm RMS apart. MuJoCo's linear solves end after 50 iterations, which "
        f"{unfinished} of the steps with 4 and 8 substeps use up; those of its limit after 500, which "
        f"{theirs['unfinished']:.0%} use up (`benchmarks/sim/flex.py` says why).",
        "",
        *table(figures),
    ]


def kernel(size: Size) -> list[str]:
    """The dominant loops beside C."""
    comparison = work("kernel", points=41, repeats=3 * size.repeats)
    if "missing" in comparison:
        return [f"Loops beside C: skipped, {comparison['missing']}.", ""]
    seconds = np.array(comparison["seconds"])
    lines = ["| loop, 8 designs of 41 x 41, one core | Taichi, us | C with AVX2, us |", "|---|---|---|"]
    figures = []
    for k, name in enumerate(("forces of the cloth", "the flat cloth's own solve")):
        taichi, c = 1e6 * np.median(seconds[:, k], axis=0)
        lines.append(f"| {name} | {taichi:.0f} | {c:.0f} |")
        figures.append(Figure(f"{name}, Taichi over C", list(seconds[:, k, 0] / seconds[:, k, 1]), "", 2.0))
    forces, solution = comparison["apart"]
    return [
        *lines,
        "",
        f"Both agree to {forces:.0e} and {solution:.0e} of the largest value.",
        "",
        *table(figures),
    ]


def scaling(size: Size) -> list[str]:
    """0.1 s, only the last shape kept: by designs at 41 points, by points with 8 designs."""
    grid = [(count, 41) for count in size.designs] + [(8, points) for points in size.points if points != 41]
    lines = [
        "| designs | points a side | CPU s | CPU s a design | wall s | peak memory, MB |",
        "|---|---|---|---|---|---|",
    ]
    each, figures = {}, []
    for count, points in grid:
        run = work("shapes", count=count, points=points, repeats=1 if count > 100 else size.repeats)
        cpu, wall = Figure("", run["cpu"], "").median, Figure("", run["wall"], "").median
        each[count, points] = cpu / count
        sizes = f"{cpu:.2f} | {cpu / count:.3f} | {wall:.2f} | {run['rss'] / 1e6:.0f}"
        lines.append(f"| {count} | {points} | {sizes} |")
        if count == 1024:
            figures.append(Figure("1,024 designs of 41 x 41: peak memory", [run["rss"] / GIGABYTE], " GB", 2.0))
    if (1024, 41) in each:
        figures.append(Figure("CPU a design, 1,024 designs over 32", [each[1024, 41] / each[32, 41]], ""))
    largest = max(size.points)
    share = each[8, largest] / largest**2 / (each[8, 41] / 41**2)
    figures.append(Figure(f"CPU a point, {largest} points a side over 41", [share], ""))
    return [
        "0.1 s of motion, only the last shape kept, the process's own peak of memory; 128 and 1,024 designs once:",
        "",
        *lines,
        "",
        *table(figures),
    ]


def start(size: Size) -> list[str]:
    """From a fresh process to the first frame."""
    work("first", lanes=2)  # the cache
    taken = [work("first", lanes=2)["taken"] for _ in range(size.repeats)]
    return table([Figure("import to first result, one design of 41 x 41, lanes of 2, warm cache", taken, " s", 3.0)])
