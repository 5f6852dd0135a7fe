"""The seed paper's network evaluated with the paper's split: frames shuffled before they are split, so that neighbours
of the frames evaluated were learned from (it leaks; `fabdesign train --network paper` splits by trial).

    python -m benchmarks.paper_split SET --model M0.toml --work FOLDER -o TABLE.md

All trials of role `fit` take part; of each a fifth of its frames, at random, is not learned from and is evaluated, from
the sixth frame on, by Chamfer distance. Sensitive stretches are left out. Goes on where it stood.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import commit
from corrector.paper import PaperCorrector
from corrector.paper_training import PaperTraining
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model
from fabdesign.geometry.metrics import Errors, mean_errors, trial_errors
from fabdesign.nouns.forward import with_history
from fabdesign.nouns.predictor import Predictor
from fabdesign.output import work_folder, write_text
from fabdesign.runtime.store import Checkpoint
from sim import Simulator
from studies.measured.fit_data import noise_of
from studies.measured.used_frames import GRID
from studies.prediction.evaluate import unordered_errors
from studies.training.data import Chosen, KeptMotions, TrainingOptions, choose
from studies.training.networks import train_paper

KEPT_BACK = 0.2  # of a trial's frames
SEED = 0


def say(what: str, done: int, total: int) -> None:
    print(f"{what} {done} of {total}", flush=True)


def errors_of(
    trials: list[Chosen],
    away: list[NDArray[np.bool_]],
    network: PaperCorrector,
    forward: Predictor,
    checkpoint: Checkpoint,
) -> list[tuple[str, Errors, Errors]]:
    """Of each trial its design, and its errors before and after on the frames `away`."""
    motions = KeptMotions(forward, checkpoint, say, history=network.history()).of(trials)
    noise = noise_of([chosen.trial for chosen in trials])
    errors = []
    for chosen, motion, kept_back in zip(trials, motions, away, strict=True):
        trial = chosen.trial
        kept = np.flatnonzero(chosen.used & kept_back & (trial.times >= network.starts))
        if not len(kept):
            continue
        clouds = [trial.load().frames[k] for k in kept]
        simple = motion[_plain(trial.times, network)]
        answer = network.correct([chosen.case], [trial.times], [motion])[0]
        before = trial_errors(clouds, simple[kept], noise, seed=SEED + trial.order)
        errors.append((trial.design_name, before, unordered_errors(clouds, answer[kept], before.chamfer_floor)))
    return errors


def _plain(times: NDArray[np.float64], network: PaperCorrector) -> NDArray[np.intp]:
    return np.asarray(with_history(times, network.history())[1][0])


def table(errors: list[tuple[str, Errors, Errors]]) -> str:
    lines = [
        f"`python -m benchmarks.paper_split`, commit {commit()}; Chamfer in mm, frames kept back from the sixth on.",
        "",
        "| | trials | without corrector | paper, split by shuffled frames | floor |",
        "|---|---|---|---|---|",
    ]
    for name in sorted({design for design, *_ in errors}):
        of_design = [(before, after) for design, before, after in errors if design == name]
        before, after = (mean_errors(list(each)) for each in zip(*of_design, strict=True))
        lines.append(
            f"| *{name}* | {len(of_design)} | {1e3 * before.chamfer:.2f} | {1e3 * after.chamfer:.2f} "
            f"| {1e3 * before.chamfer_floor:.2f} |"
        )
    return "\n".join([*lines, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    base = read_model(options.model).without(["corrector"])
    chosen = TrainingOptions(base, kept_back=0.1, seed=SEED, coarse=Simulator(GRID))
    learned, held, _ = choose([read_set(options.set)], chosen)
    trials, rng = [*learned, *held], np.random.default_rng(SEED)
    away = [rng.random(len(chosen.trial.times)) < KEPT_BACK for chosen in trials]
    shown = [replace(c, used=c.used & ~kept_back) for c, kept_back in zip(trials, away, strict=True)]
    forward = Predictor(Simulator(base.points_per_side), sensing=True)
    with work_folder(options.work, made_by="paper_split") as work:
        plan = PaperTraining.here(SEED)
        checkpoint = Checkpoint(work, {"set": str(options.set), "model": base.central_hash, "plan": repr(plan)})
        weights, about = train_paper(shown, forward, plan, checkpoint, progress=say)
        errors = errors_of(trials, away, PaperCorrector.of(weights, about), forward, checkpoint)
    text = table(errors)
    write_text(options.output, text)
    print(text)


if __name__ == "__main__":
    main()
