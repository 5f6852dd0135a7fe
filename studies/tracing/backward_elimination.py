"""Backwards from the joint fit: what the data do not need, or what trials left out gain too little by, is dropped."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from fabdesign.effects import EFFECTS
from fabdesign.effects.registry import label_effect
from fabdesign.geometry.metrics import over
from fabdesign.units import in_mm
from optimize.fit.clouds import Indices
from optimize.fit.cross_validation import Gain, LeftOut
from optimize.fit.fitted import Fit
from optimize.fit.parameters import FitVector
from optimize.fit.significance import NEEDED, cheapest_first, conditioned, cost, needed
from studies.tracing.decoys import Decoys, decoys_beside
from studies.tracing.reduction import promised, reduced
from studies.tracing.refits import Judged, fit_alone, fit_of, fit_without, is_certain, needed_elsewhere
from studies.tracing.task import Place, Task

CAUSE = 0.3  # of its prior's deviation, at its strongest: an effect that is less is in any careful build
_MUCH = 1.2  # times what a fit may lose of trials left out, in quadrature: what loses more even of those fitted ends
_NONE = np.zeros(0, dtype=np.intp)


def backwards(task: Task, everything: Fit, plain: Fit) -> tuple[Fit, Fit, list[str], Decoys | None]:
    """The declared parameters alone; the fit with the effects that are needed, the same without any; effects that are
    certain but gain too little; and decoys beside that fit. plain: where the declared parameters ended by themselves,
    by the weights of `everything`."""
    labels, small = worth(task, everything)
    if not labels:
        alone = fit_alone(task, everything, plain)
        return alone, alone, small, None
    known = _enough(task, everything, labels) or fit_of(task, *reduced(task, everything, labels), sure=True)
    most = judged = Judged(task, known)  # most: the fit with most effects
    exact = True  # whether the fit's Jacobian was made where it ends
    left_of_all = LeftOut.of(everything, task.data.folds).scored().excess(task.floor)
    held: list[str] = []  # what a fit without it loses; with fewer others beside it, that loses all the more
    gains = gains_of(parts_of(known.vector), judged.trials, task.floor)
    decoys: Decoys | None = None
    while True:
        if len(gains) == 1:
            plain = fit_alone(task, known, plain)
        # beside a stronger one an effect must gain more than is left, by those that stay or by all: where its law is
        # not quite right, small ones take up what it lacks
        least = (
            max(task.tolerance, min(left_of_all, judged.scored.excess(task.floor)))
            if len(gains) > 1
            else task.tolerance
        )
        least = least if decoys is None else max(least, decoys.chance)
        told = ", ".join(f"{label} {in_mm(gain):.2f}" for label, (gain, _) in gains.items())
        task.say(f"mm of excess that trials left out gain by each: {told}; least {in_mm(least):.2f}")
        weak = _below_of(judged, least, held)
        if weak and len(gains) == 1:
            return plain, plain, [*small, *weak], None
        if weak:
            simpler, weak = _without_most_of(task, known, most, weak, least)
            held += weak[:1] if simpler is None else []
        elif (fewer := _simpler(known, most, plain, gains, least, held)) is not None:
            simpler, weak = fewer[0], [fewer[1]]
            if len(gains) == 1:
                return plain, plain, [*small, *weak], None
        elif not exact:
            simpler, weak = fit_of(task, known, known.vector.labels, sure=True), []
        elif decoys is None:
            decoys = decoys_beside(task, known, everything.vector)
            held = [] if decoys.chance > least else held
            continue
        elif any(is_cause(known, label) for label in gains):
            return plain, known, small, decoys
        else:  # what is next to nothing shows only where a cloth is about to snap, and there as much as anything
            weak = [min(gains, key=partial(strength, known))]
            task.say(f"{weak[0]} is {strength(known, weak[0]):.2f} of what is usual: no cause")
            if len(gains) == 1:
                return plain, plain, [*small, *weak], None
            simpler = fit_without(task, known, weak)
            most, held = Judged(task, simpler), []
        if simpler is not None:
            small += weak
            known, decoys, exact = simpler, None, not weak
            judged = Judged(task, known)
            gains = gains_of(parts_of(known.vector), judged.trials, task.floor)


def _below_of(judged: Judged, least: float, held: Sequence[str]) -> list[str]:
    """Return the effects of a fit that trials left out gain too little by; one stays to be asked alone. held: not
    asked."""
    task, vector = judged.task, judged.fit.vector

    def stays(gone: Sequence[str], label: str) -> bool:
        return 0 < len(gone) == len(vector.labels) - 1 or _cause_elsewhere(task, judged.fit, label)

    asked = [label for label in vector.labels if label not in held]
    return _below(judged, asked, [], least, stays)


def _below(
    judged: Judged, asked: Sequence[str], gone: Sequence[str], least: float, stays: Callable[[Sequence[str], str], bool]
) -> list[str]:
    """Return the effects of those `asked` that trials left out gain less by than `least` [m], or not for certain, to
    first order, one after another, the least first. gone: effects that are off already. stays: of those that are off
    and one more, whether that is not dropped for another reason."""
    vector, below = judged.fit.vector, list[str]()
    while True:
        off = [label for label in vector.labels if label in gone or label in below]
        parts = {label: vector.part(label) for label in asked if label not in below}
        gains = gains_of(parts, judged.trials, judged.task.floor, vector.parts(off))
        weak = weakest(gains, least, partial(stays, off))
        if weak is None:
            return below
        below.append(weak)


def _without_most_of(
    task: Task, known: Fit, most: Judged, weak: list[str], least: float
) -> tuple[Fit | None, list[str]]:
    """Return a fit without as many of the effects `weak`, the first of them, as it loses nothing by, and these; None
    and the first where even that is needed."""
    while True:
        simpler = fit_without(task, known, weak)
        if not most.loses(simpler, least, any(is_cause(known, label) for label in weak)):
            return simpler, weak
        if len(weak) == 1:
            return None, weak
        weak = weak[: (len(weak) + 1) // 2]


def _enough(task: Task, everything: Fit, labels: Sequence[str]) -> Fit | None:
    """The fit with one of the effects alone, that which costs most to drop, if it leaves as little as all together do,
    to first order: the joint fit shares out what it does, and one by one the others go only slowly."""
    vector = everything.vector
    gone = vector.parts(label for label in vector.labels if label not in labels)
    there = conditioned(everything.minimum, everything.covariance, gone)
    *_, (strongest, _, _) = cheapest_first(*there, {label: vector.part(label) for label in labels})
    least = promised(everything, everything.minimum)
    hopeless = float(np.hypot(least, task.tolerance))
    one = fit_of(task, everything, [strongest], hopeless=hopeless, sure=True, named=f"{strongest} alone")
    fits = over(one.after, least) <= 0.5 * task.tolerance
    return one if fits and not needed_elsewhere(task, everything, vector.inside(there[0]), one) else None


def strength(known: Fit, label: str) -> float:
    """Of an effect of a fit, the strongest of its strengths, in deviations of their priors."""
    keys, vector = EFFECTS[label_effect(label)].strengths, known.vector
    own = [k for k in vector.part(label) if vector.parameters[k].name.rpartition(".")[2] in keys]
    return float((np.abs(known.x[own]) / vector.prior[own]).max())


def is_cause(known: Fit, label: str) -> bool:
    """Whether an effect of a fit is more than what is in any careful build."""
    return strength(known, label) >= CAUSE


def gains_of(parts: Mapping[str, Indices], left: LeftOut, floor: float, off: Indices = _NONE) -> dict[str, Gain]:
    """By each effect of a fit, of which `parts` are the unknowns: m of excess, in quadrature, that trials left out gain
    by it, and 90 %. off: unknowns that are zero."""
    own = left.scored(off)
    return {label: left.gain(left.scored(np.concatenate([off, part])), own, floor) for label, part in parts.items()}


def parts_of(vector: FitVector) -> dict[str, Indices]:
    """Which unknowns are those of each term, by its label."""
    return {label: vector.part(label) for label in vector.labels}


def sparse(everything: Fit, labels: Sequence[str]) -> list[str]:
    """Of several places or channels of one effect, the one that costs most to drop: the sparse case."""
    x, covariance = everything.minimum, everything.covariance
    costs = {label: cost(x, covariance, everything.vector.part(label)) for label in labels}
    best: dict[str, str] = {}
    for label in sorted(labels, key=lambda label: costs[label]):
        best[label_effect(label)] = label
    return [label for label in labels if label in best.values()]


def worth(task: Task, everything: Fit) -> tuple[list[str], list[str]]:
    """The terms that the joint fit says the data need, and of those the ones that trials left out gain too little by,
    to first order. Shapes are not fitted yet, so what is left says nothing."""
    vector, judged = everything.vector, Judged(task, everything)
    certain = needed(everything.minimum, everything.covariance, vector, NEEDED)
    labels = _with_channels(task, judged.trials, vector, certain, sparse(everything, certain))
    gone = [label for label in vector.labels if label not in labels]
    small = _below(judged, labels, gone, task.tolerance, partial(_matters_elsewhere, task, everything))
    return [label for label in labels if label not in small], small


def _with_channels(
    task: Task, trials: LeftOut, vector: FitVector, certain: Sequence[str], few: Sequence[str]
) -> list[str]:
    """Those that are sparse, and the other channels of their effects where trials left out gain by them together. A
    place moves to where it is in a fit."""
    kept = [label for label in certain if label in few or _sits_in_a_channel(label)]
    one, all_of_them = (
        trials.scored(vector.parts([label for label in vector.labels if label not in own])) for own in (few, kept)
    )
    several = len(kept) > len(few) and is_certain(trials.gain(one, all_of_them, task.floor), task.tolerance)
    return kept if several else [*few]


def _sits_in_a_channel(label: str) -> bool:
    effect = EFFECTS[label_effect(label)]
    return bool(effect.chosen) and all(effect.parameters[name].whole for name in effect.chosen)


def weakest(gains: Mapping[str, Gain], least: float, stays: Callable[[str], bool] = lambda label: False) -> str | None:
    """The effect that trials left out gain least by, of those for which that is not certain or under `least` [m], and
    that does not stay for another reason."""
    rising = sorted(gains, key=lambda label: gains[label][0])
    return next((k for k in rising if not is_certain(gains[k], least) and not stays(k)), None)


def _matters_elsewhere(task: Task, joint: Fit, gone: Sequence[str], label: str) -> bool:
    """Whether a fit with terms `gone` off differs on other layouts where one more is, to first order: by the tolerance,
    whatever is left of trials left out."""
    vector, x, covariance = joint.vector, joint.minimum, joint.covariance
    with_it, without = (conditioned(x, covariance, vector.parts(labels))[0] for labels in (gone, [*gone, label]))
    return task.matters_elsewhere(Place(vector, vector.inside(with_it)), Place(vector, vector.inside(without)))


def _cause_elsewhere(task: Task, known: Fit, label: str) -> bool:
    """Whether an effect of a fit may be a cause, and other layouts tell that it is there."""
    return is_cause(known, label) and _matters_elsewhere(task, known, [], label)


def _simpler(
    known: Fit, most: Judged, plain: Fit, gains: Mapping[str, Gain], least: float, held: list[str]
) -> tuple[Fit, str] | None:
    """A fit without one of the effects that does as well as that with `most`, and which: what is not linear may take
    its place, and which of two gains more to first order may be wrong. plain: that of the declared parameters alone.
    held: not asked again; those that are found to be needed are added."""
    for label in sorted(gains.keys() - {*held}, key=lambda label: gains[label][0]):
        fitted = plain
        if len(gains) > 1:
            hopeless = float(np.hypot(most.fit.after, _MUCH * least))
            fitted = fit_without(most.task, known, [label], hopeless=hopeless)
        if not most.loses(fitted, least, is_cause(known, label)):
            return fitted, label
        held.append(label)
    return None
