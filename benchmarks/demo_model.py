"""What the demo ships beside its target: a few trials of a measured set, thinned, and a model trained on that set.

    python -m benchmarks.demo_model SET [--work FOLDER] [-o fabdesign/data]
    python -m benchmarks.demo_model SET --model M.toml [-o fabdesign/data]

The first fits factors and every effect and trains the corrector, as `fabdesign train SET --free all --grid 21 -o
FOLDER/model.toml` does, on trials of role `fit` alone, where FOLDER has no model yet; stopped, the same command goes
on. The second takes a model that is there.
The trials that are shipped are those of one design with the role `test`, which nothing is fitted to. Of each every
third frame and 800 points of a frame are kept.
"""

import argparse
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from fabdesign import interface
from fabdesign.files.measurement_set import NewTrial, read_set, write_set
from fabdesign.files.model_file import read_model, write_model
from fabdesign.files.trial_file import TrialData
from fabdesign.nouns.model import Model
from fabdesign.nouns.trial import MeasurementSet, Trial
from studies.demo.measured import MODEL, SET

DESIGN = "basic"
EVERY, POINTS = 3, 800
GRID = 21  # points a side: an iteration of 51 unknowns takes a minute


def trained(measured: Path, work: Path) -> Path:
    """The file of a model with every effect and a corrector; made where `work` has none. Raises InputError as
    `fabdesign train`."""
    file = work / "model.toml"
    if not file.is_file():
        work.mkdir(parents=True, exist_ok=True)
        interface.train(
            measured, file, free=["all"], grid=GRID, progress=lambda line, share: print(line, flush=True), say=print
        )
    return file


def ship(measured: MeasurementSet, model: Model, output: Path) -> Path:
    """Write the trials and the model to `output`; the model's weights. Raises ValueError for a model that has seen the
    trials, or that has no corrector, and where there is no such trial."""
    tests = [trial for trial in measured.trials if trial.design_name == DESIGN and trial.role == "test"]
    if not tests:
        raise ValueError(f"{measured.name}: no trial of {DESIGN} of role test")
    if seen := {f"{measured.name}/{t.name}" for t in tests} & set(model.provenance.fitted):
        raise ValueError(f"the model has seen {', '.join(sorted(seen))}; expected one that has not")
    if model.corrector is None:
        raise ValueError("the model has no corrector; expected one that `fabdesign train` made")
    shutil.rmtree(output / SET, ignore_errors=True)  # its mark was taken away
    write_set(
        output / SET,
        {DESIGN: tests[0].design},
        (NewTrial(t.name, t.design_name, t.order, t.role, thinned(t)) for t in tests),
        name=SET,
        description=f"{len(tests)} {DESIGN} trials of {measured.name}, thinned; {measured.description}",
    )
    (output / SET / ".fabdesign").unlink(missing_ok=True)
    weights = (output / MODEL).with_suffix(".safetensors")
    shutil.copyfile(model.corrector, weights)
    write_model(replace(model, corrector=weights), output / MODEL)
    return weights


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
    parser.add_argument("--model", type=Path, help="A trained model; without it one is made.")
    parser.add_argument("--work", type=Path, default=Path("build/demo_model"), help="Where the model is kept.")
    parser.add_argument("-o", "--output", type=Path, default=Path("fabdesign/data"))
    options = parser.parse_args()
    file = options.model or trained(options.set, options.work)
    try:
        weights = ship(read_set(options.set), read_model(file), options.output)
    except ValueError as error:
        parser.error(f"{file}: {error}")
    print(f"{options.output / SET}, {options.output / MODEL}: {weights.stat().st_size / 1e6:.2f} MB of weights")


if __name__ == "__main__":
    main()
