"""Trials that lie on another branch: what is left of rig_a if the start may be tilted or curled a little.

    python -m benchmarks.branches SET [--model MODEL] [--design NAME ...] [--grid N]

Each trial is simulated as the model says and with its small changes. Prints a table by design; on
synthetic rigs unless the set says otherwise.
"""

import argparse
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model
from fabdesign.nouns.predictor import Predictor
from fabdesign.units import in_mm
from sim import Simulator
from studies.prediction.stability import FAR, Branches, branches_of

EVERY = 5  # frames


def table(branches: Sequence[Branches]) -> str:
    """Markdown, a row a design; mm."""
    rows = [
        "| design | trials | model alone, mm | nearest branch | over 3 mm | of those on another branch | odds there |"
    ]
    rows.append("|---|---|---|---|---|---|---|")
    for name in dict.fromkeys(b.trial.design.name for b in branches):
        of_design = [b for b in branches if b.trial.design.name == name]
        far, elsewhere = [b for b in of_design if b.unchanged > FAR], [b for b in of_design if b.on_another_branch]
        nearest = [b.nearest if b.on_another_branch else b.unchanged for b in of_design]
        alone_rms, nearest_rms = (
            in_mm(float(np.sqrt(np.mean(np.square(values))))) for values in ([b.unchanged for b in of_design], nearest)
        )
        odds = f"{np.median([b.odds for b in elsewhere]):.2f}" if elsewhere else "-"
        rows.append(
            f"| {name} | {len(of_design)} | {alone_rms:.2f} | {nearest_rms:.2f} "
            f"| {len(far)} | {len(elsewhere)} | {odds} |"
        )
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("--model", type=Path, default=Path(str(files("fabdesign") / "data" / "demo_model.toml")))
    parser.add_argument("--design", nargs="*", default=())
    parser.add_argument("--grid", type=int, default=41)
    options = parser.parse_args()
    model = read_model(options.model).without(["corrector"])
    trials = [t for t in read_set(options.set).trials if not options.design or t.design.name in options.design]
    branches = list(branches_of(trials, Predictor(Simulator(options.grid), model, sensing=True), every=EVERY))
    print(table(branches))
    for b in branches:
        if b.unchanged > FAR:
            print(
                f"{b.trial.name} ({b.trial.design.name}): {in_mm(b.unchanged):.2f} mm, nearest {in_mm(b.nearest):.2f}"
            )


if __name__ == "__main__":
    main()
