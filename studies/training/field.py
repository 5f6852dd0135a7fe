"""The field network's training: examples, the network itself, and how far it is to be trusted."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corrector.cloth import Cloth
from corrector.designs import described, distance
from corrector.examples import Examples
from corrector.inputs import HISTORY, Layout
from corrector.training import Trainer, Training, train_field
from fabdesign.forward import ForwardModel
from fabdesign.output import WorkFolder
from studies.training.data import Chosen, Progress, frames_learned, one_cloth, simulated

_SHORTER = 3  # a network that is only to say how far to trust one gets so many times fewer epochs
_GAIN = 0.95  # of the error before, at most, where a network counts as of use


def train(
    trials: Sequence[Chosen], forward: ForwardModel, plan: Training, work: WorkFolder, *, progress: Progress
) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """The weights, and what is to be known about them: sizes, designs learned from, the limit of trust."""
    cloth = one_cloth(trials)
    parts = _examples(trials, forward, work, progress)
    designs = {chosen.trial.design_name: chosen.trial.design for chosen in trials}
    known = {name: described(design) for name, design in designs.items()}
    unseen = known if len(known) > 1 else ()
    left_out = [_left_out(name, trials, parts, known, cloth, plan, work, progress) for name in unseen]
    weights = _trained("network", list(range(len(parts))), trials, parts, cloth, plan, work, progress)
    about = {
        "network": "field",
        "dilations": list(plan.dilations),
        "epochs": plan.epochs,
        "known": list(known.values()),
        "trust_limit": limit_of(left_out),
        "left_out": left_out,
    }
    return weights, about


def limit_of(left_out: Sequence[Mapping[str, Any]]) -> float:
    """The distance up to which every design was predicted better by a network that had not seen it; 0 where none was,
    or where no design could be left out: only designs that were learned from are corrected then."""
    limit = 0.0
    for one in sorted(left_out, key=lambda one: one["distance"]):
        if one["after_mm"] > _GAIN * one["before_mm"]:
            break
        limit = one["distance"]
    return float(limit) + 1e-9


def _left_out(
    name: str,
    trials: Sequence[Chosen],
    parts: Sequence[Examples],
    known: Mapping[str, dict[str, Any]],
    cloth: Cloth,
    plan: Training,
    work: WorkFolder,
    progress: Progress,
) -> dict[str, Any]:
    """A network that has not seen the design `name`, tried on it."""
    plan = replace(plan, epochs=max(plan.epochs // _SHORTER, 1), rematch=())
    seen = [i for i, chosen in enumerate(trials) if chosen.trial.design_name != name]
    weights = _trained(f"without-{name}", seen, trials, parts, cloth, plan, work, progress)
    unseen = Examples.joined([part for i, part in enumerate(parts) if i not in set(seen)])
    before, after = errors_mm(weights, unseen, cloth, plan)
    away = distance(known[name], [other for key, other in known.items() if key != name])
    return {"design": name, "distance": away, "before_mm": before, "after_mm": after}


def errors_mm(
    weights: Mapping[str, NDArray[np.float32]], examples: Examples, cloth: Cloth, plan: Training
) -> tuple[float, float]:
    """mm, RMS over the nodes of how far the cloth is off along the normal, mean over frames: before and after."""
    trainer = Trainer(examples, cloth, plan)
    trainer.set_arrays(weights)
    moved = np.einsum("...i,...i->...", examples.along, trainer.displacements(examples))
    result = []
    for residual in (examples.goal, examples.goal - moved):
        squared = np.square(np.clip(residual, -0.010, 0.010)) * examples.weight
        frames = squared.sum(axis=(1, 2)) / np.maximum(examples.weight.sum(axis=(1, 2)), 1)
        result.append(1e3 * float(np.sqrt(frames).mean()))
    return result[0], result[1]


def _trained(
    name: str,
    rows: Sequence[int],
    trials: Sequence[Chosen],
    parts: Sequence[Examples],
    cloth: Cloth,
    plan: Training,
    work: WorkFolder,
    progress: Progress,
) -> dict[str, NDArray[np.float32]]:
    examples = Examples.joined([parts[i] for i in rows])
    ends = np.cumsum([len(parts[i]) for i in rows])[:-1]

    def rematch(moved: NDArray[np.float32]) -> Examples:
        progress(f"matching again for {name},", 0, len(rows))
        again = []
        for i, own in zip(rows, np.split(moved, ends), strict=True):
            again.append(parts[i].rematched(own, _clouds(trials[i]), trials[i].trial.design.fabric))
        return Examples.joined(again)

    checkpoint = f"{name}.pt"
    work.claim(checkpoint, f"{name}-matched.pt")
    return train_field(
        examples,
        cloth,
        plan,
        checkpoint=work.folder / checkpoint,
        rematch=rematch if plan.rematch else None,
        progress=lambda done, total, loss: progress(f"{name}, {loss:.2f} mm, epoch", done, total),
    )


def _examples(trials: Sequence[Chosen], forward: ForwardModel, work: WorkFolder, progress: Progress) -> list[Examples]:
    names = [f"examples/{chosen.key}.npz" for chosen in trials]
    work.claim(*names)
    missing = [chosen for chosen, name in zip(trials, names, strict=True) if not (work.folder / name).is_file()]
    motions = simulated(missing, _times_learned, HISTORY, forward, work, progress=progress) if missing else []
    layouts: dict[int, Layout] = {}
    for k, (chosen, motion) in enumerate(zip(missing, motions, strict=True)):
        trial = chosen.trial
        if id(trial.design) not in layouts:
            layouts[id(trial.design)] = Layout.of(trial.design)
        found = Examples.of(chosen.case, layouts[id(trial.design)], _times_learned(chosen), motion, _clouds(chosen))
        found.save(work.folder / f"examples/{chosen.key}.npz")
        progress("matched", len(trials) - len(missing) + k + 1, len(trials))
    return [Examples.load(work.folder / name) for name in names]


def _times_learned(chosen: Chosen) -> NDArray[np.float64]:
    return chosen.trial.times[frames_learned(chosen)]


def _clouds(chosen: Chosen) -> list[NDArray[np.float64]]:
    frames = chosen.trial.load().frames
    return [frames[i] for i in frames_learned(chosen)]
