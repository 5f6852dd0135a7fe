"""What the demo ships beside its target: a few trials of a measured set, thinned, and a model trained on that set.

    python -m benchmarks.demo_model SET --model M.toml [-o fabdesign/data]

M.toml is what `fabdesign calibrate SET -o M0.toml`, with the effects that the set shows (`--free`, or `fabdesign trace
SET --model M0.toml -o T` and its T/model.toml), and `fabdesign train SET --model M0.toml -o M.toml` made.
The trials are those of one design with the role `test`, which nothing is fitted to. Of each every third frame and 800
points of a frame are kept.
"""

import argparse
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from fabdesign.measurement_set import NewTrial, read_set, write_set
from fabdesign.model_file import read_model, write_model
from fabdesign.trial import Trial, TrialData
from studies.demo.measured import MODEL, SET

DESIGN = "basic"
EVERY, POINTS = 3, 800


def thinned(trial: Trial) -> TrialData:
    data, rng = trial.load(), np.random.default_rng(trial.order)
    kept = np.arange(len(data.time) - 1, -1, -EVERY)[::-1]
    frames = tuple(
        data.frames[k][np.sort(rng.choice(len(data.frames[k]), min(POINTS, len(data.frames[k])), replace=False))]
        for k in kept
    )
    return TrialData(data.time[kept], data.pressure[kept], frames)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, default=Path("fabdesign/data"))
    options = parser.parse_args()
    measured, model = read_set(options.set), read_model(options.model)
    tests = [trial for trial in measured.trials if trial.design_name == DESIGN and trial.role == "test"]
    if seen := {f"{measured.name}/{t.name}" for t in tests} & set(model.provenance.fitted):
        parser.error(f"{options.model} has seen {', '.join(sorted(seen))}; expected a model that has not")
    shutil.rmtree(options.output / SET, ignore_errors=True)  # its mark was taken away
    write_set(
        options.output / SET,
        {DESIGN: tests[0].design},
        (NewTrial(t.name, t.design_name, t.order, t.role, thinned(t)) for t in tests),
        name=SET,
        description=f"{len(tests)} {DESIGN} trials of {measured.name}, thinned; {measured.description}",
        made_by="demo_model",
    )
    (options.output / SET / ".fabdesign").unlink(missing_ok=True)
    weights = (options.output / MODEL).with_suffix(".safetensors")
    assert model.corrector is not None
    shutil.copyfile(model.corrector, weights)
    write_model(replace(model, corrector=weights), options.output / MODEL)
    print(f"{options.output / SET}, {options.output / MODEL}: {weights.stat().st_size / 1e6:.2f} MB of weights")


if __name__ == "__main__":
    main()
