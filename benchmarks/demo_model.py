"""What the demo ships beside its target: a few trials of a measured set, thinned, and a model trained on that set.

    python -m benchmarks.demo_model SET --model M.toml [-o fabdesign/data]

M.toml is what `fabdesign calibrate SET -o M0.toml` and `fabdesign train SET --model M0.toml -o M.toml` made. Trials of
one design: six of role `fit`, spread over the session, and those of role `test`, which no training sees. Of each every
third frame and 800 points of a frame are kept.
"""

import argparse
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from fabdesign.measurement_set import NewTrial, read_set, write_set
from fabdesign.model_file import read_model, write_model
from fabdesign.trial import Trial, TrialData
from studies.calibration.clouds import evenly
from studies.demo.measured import MODEL, SET

DESIGN = "basic"
FIT = 6
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
    own = [trial for trial in measured.trials if trial.design_name == DESIGN]
    tests = [trial for trial in own if trial.role == "test"]
    if seen := {f"{measured.name}/{t.name}" for t in tests} & set(model.provenance.fitted):
        parser.error(f"{options.model} has seen {', '.join(sorted(seen))}; expected a model that has not")
    fit = [trial for trial in own if trial.role == "fit"]
    chosen = [*(fit[i] for i in evenly(len(fit), FIT)), *tests]
    write_set(
        options.output / SET,
        {DESIGN: own[0].design},
        (NewTrial(t.name, t.design_name, t.order, t.role, thinned(t)) for t in sorted(chosen, key=lambda t: t.order)),
        name=SET,
        description=f"{len(chosen)} {DESIGN} trials of {measured.name}, thinned; {measured.description}",
        made_by="demo_model",
        force=True,
    )
    (options.output / SET / ".fabdesign").unlink(missing_ok=True)
    weights = (options.output / MODEL).with_suffix(".safetensors")
    assert model.corrector is not None
    shutil.copyfile(model.corrector, weights)
    write_model(replace(model, corrector=weights), options.output / MODEL)
    print(f"{options.output / SET}, {options.output / MODEL}: {weights.stat().st_size / 1e6:.2f} MB of weights")


if __name__ == "__main__":
    main()
