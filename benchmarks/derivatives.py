"""What a column of a shape's Jacobian costs beside the shape, and how it agrees with the float64 reference.

    python -m benchmarks.derivatives [-o docs/results/derivatives.md]

Costs are processor seconds of a batch of eight designs with 24 columns each, in turn with the shapes alone: medians of
ROUNDS ratios.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.machine import commit, processor
from fabdesign import column
from fabdesign.catalogue import build
from fabdesign.column import Column
from fabdesign.forward import PARAMETERS, Case
from fabdesign.pressure import PressureProgram
from sim import Simulator
from tests.derivatives_reference import kinds, lacking

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
        Case(design, PressureProgram(np.zeros(1), 1e3 * own[None], 1.5))
        for design, own in zip(designs, kpa, strict=True)
    ]


def columns() -> list[Column]:
    """24: pressures, factors, ends of muscles, an effect's parameters."""
    return [
        *(column.pressure(k) for k in range(4)),
        *(column.factor(name) for name in PARAMETERS if name != "damping"),
        *(column.corner(k, end, (1.0, 0.0)) for k in range(4) for end in range(2)),
        *(column.corner(k, 1, (0.0, -1.0)) for k in range(3)),
        *(column.of_effect("rest_curvature", name, 0.1) for name in ("across", "down", "twist")),
    ]


def ratios(points: int) -> tuple[float, list[float], int, int]:
    """CPU s of the eight shapes (median), a column's cost over a shape's by round, columns by the tangent, of all."""
    simulator, own, directions = Simulator(points_per_side=points), cases(), columns()
    spent, found = [], []
    for k in range(ROUNDS + 1):
        begin = time.process_time()
        simulator.rest(own)
        middle = time.process_time()
        jacobians = simulator.shape_jacobian(own, directions)
        end = time.process_time()
        if k:  # the first compiles
            spent.append(middle - begin)
            # the Jacobian finds the shapes too
            found.append((end - middle - (middle - begin)) / len(directions) / (middle - begin))
    exact = sum(int(one.exact.sum()) for one in jacobians)
    return float(np.median(spent)), found, exact, len(own) * len(directions)


def agreement() -> dict[str, list[float]]:
    """Of each kind of column: what the reference's balance of forces lacks (tests/derivatives_reference.py)."""
    own = cases()
    off: dict[str, list[float]] = {one.name: [] for one in kinds()}
    for case, found in zip(own, Simulator(points_per_side=COMPARED).shape_jacobian(own, kinds()), strict=True):
        for one, value in zip(kinds(), lacking(case, kinds(), found.middle, found.changes), strict=True):
            off[one.name].append(float(value))
    return off


def page(sizes: Sequence[int]) -> list[str]:
    lines = [
        "# Derivatives: what a column costs, and whether it is right",
        "",
        f"`python -m benchmarks.derivatives` at {commit()}, {processor()}. A column is a direction in the parameters",
        "(`fabdesign/column.py`); the tangent and its equations are in [model.md](../model.md#derivatives).",
        "",
        "## Cost",
        "",
        f"Eight designs, 24 columns each; processor time, medians of {ROUNDS} rounds (least and most).",
        "",
        "| points a side | eight shapes [CPU s] | a column over a shape | bound | columns by the tangent |",
        "|---|---|---|---|---|",
    ]
    for points in sizes:
        shapes, found, exact, total = ratios(points)
        lines.append(
            f"| {points} | {shapes:.2f} | {np.median(found):.3f} ({min(found):.3f} to {max(found):.3f}) | 0.050 "
            f"| {exact} of {total} |"
        )
    found_off = agreement()
    every = np.concatenate([*found_off.values()])
    lines += [
        "",
        "## Agreement with the float64 reference",
        "",
        f"Of eight shapes at {COMPARED} points a side: what the reference's balance of forces lacks along a column,",
        "as a displacement by its Gauss-Newton stiffness, over the column (norms).",
        f"Within 1e-2: {np.sum(every <= BOUND)} of {len(every)} (bound 95 %).",
        "",
        "| column | median | most |",
        "|---|---|---|",
    ]
    lines += [f"| {name} | {np.median(off):.1e} | {max(off):.1e} |" for name, off in found_off.items()]
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/results/derivatives.md"))
    output = parser.parse_args().output
    output.write_text("\n".join(page(SIZES)) + "\n")


if __name__ == "__main__":
    main()
