"""The paper's network, trained on measured sets."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corrector.layout import described
from corrector.paper import FRAMES
from corrector.paper_training import PaperTraining, TrainingPairs, train_paper
from fabdesign.errors import InputError
from fabdesign.nouns.forward import ForwardModel
from fabdesign.runtime.store import Checkpoint
from studies.training.data import Chosen, KeptMotions, Progress

_PARTS = ("simulated", "measured", "following")


def train(
    trials: Sequence[Chosen], forward: ForwardModel, plan: PaperTraining, checkpoint: Checkpoint, *, progress: Progress
) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Return the weights, and what is to be known about them. Raises InputError where frames are not evenly spaced
    alike, or too few."""
    rate = _frame_rate(trials)
    motions = KeptMotions(forward, checkpoint, progress).of(trials)
    pairs = [
        TrainingPairs(motion, chosen.trial.load().frames, chosen.used)
        for chosen, motion in zip(trials, motions, strict=True)
    ]
    folder = checkpoint.claim(*(f"paper-{part}.pt" for part in _PARTS))
    weights = train_paper(pairs, plan, folder, progress=progress)
    designs = {chosen.trial.design_name: chosen.trial.design for chosen in trials}
    return weights, about(plan, rate, [described(design) for design in designs.values()])


def about(plan: PaperTraining, rate: float, known: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what the weights' file says. rate: of the frames [Hz]."""
    return {
        "network": "paper",
        "code": plan.code,
        "points": plan.points,
        "epochs": list(plan.epochs),
        "frame_rate": rate,
        "known": known,
        "trust_limit": None,
        "left_out": [],
    }


def _frame_rate(trials: Sequence[Chosen]) -> float:
    """Return the frame rate [Hz] of all trials."""
    steps = np.concatenate([np.diff(chosen.trial.times) for chosen in trials])
    for chosen in trials:
        if len(chosen.trial.times) <= FRAMES:
            raise InputError(f"{chosen.name}: {len(chosen.trial.times)} frames; expected more than {FRAMES}")
    step = float(np.median(steps))
    if np.abs(steps - step).max() > 0.1 * step:
        raise InputError(
            f"frames {steps.min():g} to {steps.max():g} s apart; the paper's network expects all trials' frames evenly "
            "spaced alike"
        )
    return 1 / step
