"""The training of each network: of the field corrector its examples, its coefficients and the limit of its trust; of
the paper's, which loads PyTorch where it is asked for, the pairs of clouds."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from corrector.basis import every_function
from corrector.field import Examples, Regression, best_penalty, coefficients_of, errors_of, relative_error
from corrector.inputs import HISTORY, described, distance
from fabdesign.errors import InputError
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import ForwardModel
from fabdesign.runtime.store import Arrays, Checkpoint
from studies.measured.splits import by_program, folds
from studies.training.data import Chosen, KeptMotions, Progress, check_one_cloth, frames_learned

if TYPE_CHECKING:
    from corrector.paper_training import PaperTraining

_GAIN = 0.95  # of the error before, at most, where a correction counts as of use


def train_field(
    trials: Sequence[Chosen], forward: ForwardModel, plan: Regression, checkpoint: Checkpoint, *, progress: Progress
) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Return the coefficients, and what is known of them: designs learned from, what was chosen, the limit of trust."""
    check_one_cloth(trials)
    functions = every_function()
    examples = _examples(trials, forward, checkpoint, progress)
    designs = {chosen.trial.design_name: chosen.trial.design for chosen in trials}
    known = {name: described(design) for name, design in designs.items()}
    penalty = best_penalty(examples, _folds(trials, plan), plan, functions.least_effects)
    far, share, left_out = _for_unseen(trials, examples, known, plan)
    weights = {
        "seen": coefficients_of(examples, penalty, functions.least_effects),
        "unseen": share * coefficients_of(examples, far, functions.least_effects, functions.anywhere),
    }
    about = {
        "network": "field",
        "sources": list(functions.names),
        "penalty": penalty,
        "penalty_unseen": far,
        "share_unseen": share,
        "known": list(known.values()),
        "trust_limit": _limit_of(left_out),
        "left_out": left_out,
    }
    return {name: value.astype(np.float32) for name, value in weights.items()}, about


def _limit_of(left_out: Sequence[Mapping[str, Any]]) -> float:
    """Return the distance up to which every design was predicted better by a corrector that had not seen it; 0 where
    none was, or where no design could be left out: only designs that were learned from are corrected then."""
    limit = 0.0
    for one in sorted(left_out, key=lambda one: one["distance"]):
        if one["after_mm"] > _GAIN * one["before_mm"]:
            break
        limit = one["distance"]
    return float(limit) + 1e-9


def _folds(trials: Sequence[Chosen], plan: Regression) -> list[list[int]]:
    """Return indices of the trials that are kept back in turn."""
    index = {id(chosen.trial): i for i, chosen in enumerate(trials)}
    every = [chosen.trial for chosen in trials]
    if len(by_program(every)) < 2:
        return []
    return [[index[id(trial)] for trial in one.held_out] for one in folds(every, plan.folds, seed=plan.seed)]


class _Unseen(NamedTuple):
    """Penalty and share for layouts not learned from, and each design as it is predicted without its own trials."""

    penalty: float
    share: float
    left_out: list[dict[str, Any]]


def _for_unseen(
    trials: Sequence[Chosen], examples: Sequence[Examples], known: Mapping[str, dict[str, Any]], plan: Regression
) -> _Unseen:
    """Return what the design that gains least gains most by."""
    if len(known) < 2:
        return _Unseen(plan.penalties[-1], 1.0, [])
    parts, functions = {}, every_function()
    for name in known:
        of_design = [e for e, chosen in zip(examples, trials, strict=True) if chosen.trial.design_name == name]
        rest = [e for e, chosen in zip(examples, trials, strict=True) if chosen.trial.design_name != name]
        fits = [coefficients_of(rest, each, functions.least_effects, functions.anywhere) for each in plan.penalties]
        parts[name] = of_design, dict(zip(plan.penalties, fits, strict=True))

    def worst(penalty: float, share: float) -> float:
        return max(
            relative_error(of_design, share * coefficients[penalty]) for of_design, coefficients in parts.values()
        )

    penalty, share = min(((p, s) for p in plan.penalties for s in plan.shares), key=lambda both: worst(*both))
    left_out = []
    for name, (of_design, coefficients) in parts.items():
        before, after = (float(errors_of(of_design, by).mean()) for by in (None, share * coefficients[penalty]))
        away = distance(known[name], [other for key, other in known.items() if key != name])
        left_out.append({"design": name, "distance": away, "before_mm": before, "after_mm": after})
    return _Unseen(penalty, share, left_out)


def _examples(
    trials: Sequence[Chosen], forward: ForwardModel, checkpoint: Checkpoint, progress: Progress
) -> list[Examples]:
    names = [f"examples_{chosen.key}" for chosen in trials]
    missing = [chosen for chosen, name in zip(trials, names, strict=True) if not checkpoint.has(name)]
    motions = KeptMotions(forward, checkpoint, progress, _times_learned, HISTORY)
    motions.simulate(missing)

    def examples(chosen: Chosen) -> Arrays:
        (motion,) = motions.of([chosen])
        frames = chosen.trial.load().frames
        clouds = [frames[i] for i in frames_learned(chosen)]
        return vars(Examples.of(chosen.case, _times_learned(chosen), motion, clouds))

    collected = []
    for k, (chosen, name) in enumerate(zip(trials, names, strict=True)):
        collected.append(Examples(**checkpoint.arrays(name, partial(examples, chosen))))
        if chosen in missing:
            progress("matched", k + 1, len(trials))
    return collected


def _times_learned(chosen: Chosen) -> Array:
    return chosen.trial.times[frames_learned(chosen)]


def train_paper(
    trials: Sequence[Chosen],
    forward: ForwardModel,
    plan: "PaperTraining",
    checkpoint: Checkpoint,
    *,
    progress: Progress,
) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Return the weights, and what is to be known about them. Raises InputError where frames are not evenly spaced
    alike, or too few."""
    from corrector import paper_training

    rate = _frame_rate(trials)
    motions = KeptMotions(forward, checkpoint, progress).of(trials)
    pairs = [
        paper_training.TrainingPairs(motion, chosen.trial.load().frames, chosen.used)
        for chosen, motion in zip(trials, motions, strict=True)
    ]
    folder = checkpoint.claim(*(f"paper-{part}.pt" for part in ("simulated", "measured", "following")))
    weights = paper_training.train_paper(pairs, plan, folder, progress=progress)
    designs = {chosen.trial.design_name: chosen.trial.design for chosen in trials}
    return weights, {
        "network": "paper",
        "code": plan.code,
        "points": plan.points,
        "epochs": list(plan.epochs),
        "frame_rate": rate,
        "known": [described(design) for design in designs.values()],
        "trust_limit": None,
        "left_out": [],
    }


def _frame_rate(trials: Sequence[Chosen]) -> float:
    """Return the frame rate [Hz] of all trials."""
    from corrector.paper import FRAMES

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
