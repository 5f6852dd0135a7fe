"""What a column of a shape's Jacobian costs beside the shape, and how it agrees with the float64 reference.

    python -m benchmarks.derivatives        # writes its part of docs/lab/derivatives.md

Costs are processor seconds of a batch of eight designs with 24 columns each, in turn with the shapes alone: medians of
ROUNDS ratios.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.machine import ROOT, commit, processor, write_part
from fabdesign.nouns import column
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.column import Column
from fabdesign.nouns.forward import PARAMETERS, Case, Term
from fabdesign.nouns.pressure import PressureProgram
from sim import Simulator
from tests.sim.derivatives_reference import kinds, kinds_of_effects, lacking, of_effect

ROUNDS = 5
SIZES = 21, 41
COMPARED = 21  # points a side
BOUND = 1e-2  # of what a column may lack


def cases() -> list[Case]:
    """Eight designs under pressures of their own."""
    random = np.random.default_rng(34)
    designs = [build("basic", muscles=4, fixed_point_pitch=pitch) for pitch in np.linspace(0.018, 0.025, 8)]
    kpa = random.integers(0, 31, (8, 4)) * 10.0
    return [
        Case(design, PressureProgram(np.zeros(1), 1e3 * row[None], 1.5))
        for design, row in zip(designs, kpa, strict=True)
    ]


def columns() -> list[Column]:
    """24: pressures, factors, ends of muscles, an effect's parameters."""
    return [
        *(column.pressure(k) for k in range(4)),
        *(column.factor(name) for name in PARAMETERS if name != "damping"),
        *(column.corner(k, end, (1.0, 0.0)) for k in range(4) for end in range(2)),
        *(column.corner(k, 1, (0.0, -1.0)) for k in range(3)),
        *(of_effect("rest_curvature", name, 0.1) for name in ("across", "down", "twist")),
    ]


def ratios(points: int) -> tuple[float, list[float], int, int]:
    """CPU s of the eight shapes (median), a column's cost over a shape's by round, columns by the tangent, of all."""
    simulator, batch, directions = Simulator(points_per_side=points), cases(), columns()
    spent, costs = [], []
    for k in range(ROUNDS + 1):
        begin = time.process_time()
        simulator.rest(batch)
        middle = time.process_time()
        jacobians = simulator.shape_jacobian(batch, directions)
        end = time.process_time()
        if k:  # the first compiles
            spent.append(middle - begin)
            # the Jacobian finds the shapes too
            costs.append((end - middle - (middle - begin)) / len(directions) / (middle - begin))
    exact = sum(int(one.exact.sum()) for one in jacobians)
    return float(np.median(spent)), costs, exact, len(batch) * len(directions)


ON = (
    Term("rest_curvature", {"down": 1.5}),
    Term("odd_muscle", {"channel": 0.0, "factor": 0.8}),
    Term("line_loss", {"share": 0.3}),
    Term("orthotropy", {"ratio": 2.0}),
    Term("frame_tilt", {"about_x": 3.0}),
    Term("added_mass", {"mass": 0.005}),
)  # each at its usual value


def compared() -> list[Case]:
    """16: those eight, whose pressures lie on grid lines of the kernels' muscle law and whose effects are off; eight
    with effects on, under any pressures, in one of them 0 in the first channel."""
    random = np.random.default_rng(35)
    pressures = random.uniform(0.0, 300e3, (8, 4))
    pressures[0, 0] = 0.0
    return cases() + [
        replace(case, program=PressureProgram(np.zeros(1), row[None], 1.5), effects=ON)
        for case, row in zip(cases(), pressures, strict=True)
    ]


def agreement() -> tuple[dict[str, list[float]], list[float], int]:
    """Return, of each kind of column, what the reference's balance of forces (tests/sim/derivatives_reference.py) lacks
    with the kernels' muscle law; of all columns of the last eight shapes the same with the smooth law; and how many
    columns the tangent gave."""
    batch, kinds_of_all, exact, smooth = compared(), kinds() + kinds_of_effects(), 0, list[float]()
    off: dict[str, list[float]] = {one.name: [] for one in kinds_of_all}
    for case, jacobian in zip(
        batch, Simulator(points_per_side=COMPARED).shape_jacobian(batch, kinds_of_all), strict=True
    ):
        exact += int(jacobian.exact.sum())
        lacks = lacking(case, kinds_of_all, jacobian.middle, jacobian.changes, smooth=not case.effects)
        for one, value in zip(kinds_of_all, lacks, strict=True):
            off[one.name].append(float(value))
        if case.effects:
            smooth += lacking(case, kinds_of_all, jacobian.middle, jacobian.changes).tolist()
    return off, smooth, exact


def page(sizes: Sequence[int]) -> list[str]:
    lines = [
        f"`python -m benchmarks.derivatives` at {commit()}, {processor()}. A column is a direction in the parameters",
        "(`fabdesign/nouns/column.py`); the tangent and its equations are in [model.md](../model.md#derivatives).",
        "",
        "## Cost",
        "",
        f"Eight designs, 24 columns each; processor time, medians of {ROUNDS} rounds (least and most).",
        "",
        "| points a side | eight shapes [CPU s] | a column over a shape | bound | columns by the tangent |",
        "|---|---|---|---|---|",
    ]
    for points in sizes:
        shapes, costs, exact, total = ratios(points)
        lines.append(
            f"| {points} | {shapes:.2f} | {np.median(costs):.3f} ({min(costs):.3f} to {max(costs):.3f}) | 0.050 "
            f"| {exact} of {total} |"
        )
    off_by_kind, smooth, by_tangent = agreement()
    every = np.concatenate([*off_by_kind.values()])
    within = np.mean(every <= BOUND)
    lines += [
        "",
        "## Agreement with the float64 reference",
        "",
        f"Of 16 shapes at {COMPARED} points a side, half of them with effects on. The figure is what the reference's",
        "balance of forces lacks along a column, as a displacement, over the column (norms). The reference is in",
        "float64, with central differences over 1 um at most.",
        f"Within 1e-2: {np.sum(every <= BOUND)} of {len(every)}, {within:.0%} (bound 95 %); within 1e-3: "
        f"{np.mean(every <= 0.1 * BOUND):.0%}; by the tangent: {by_tangent}.",
        "",
        "Effects off: pressures on grid lines of the kernels' muscle law (multiples of 10 kPa), the reference with the",
        "smooth law. Effects on: any pressures, the reference with the law as the kernels have it, linear between grid",
        "lines; by the smooth law, whose tensions are others, "
        f"{np.mean(np.array(smooth) <= BOUND):.0%} are within 1e-2 (median {np.median(smooth):.1e}).",
        "",
        "| column | effects off: median | most | effects on: median | most |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {name} | {np.median(off[:8]):.1e} | {max(off[:8]):.1e} | {np.median(off[8:]):.1e} | {max(off[8:]):.1e} |"
        for name, off in off_by_kind.items()
    ]
    return lines


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    write_part(ROOT / "docs" / "lab" / "derivatives.md", "derivatives", "\n".join(page(SIZES)))


if __name__ == "__main__":
    main()
