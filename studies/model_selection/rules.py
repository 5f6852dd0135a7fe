"""Rules by which effects of a joint fit are dropped again: each takes a selection and returns a smaller or a better
known one, or None where it does not apply. The first that applies is followed, then all are asked anew.

A rule more is a function here, with a threshold of its own and a line of `ON_SETS` or `ON_BENCHES`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from fabdesign.units import in_mm
from optimize.fit.cross_validation import Gain
from optimize.fit.fitted import Fit
from studies.model_selection.judged import CAUSE, CHANCE, Decoys, Judged, is_cause, is_certain, strength


@dataclass(frozen=True, eq=False)
class Selection:
    """The effects that are needed. everything: the joint fit; to first order about `plain` where that is adequate.
    before: the declared parameters alone, and what trials left out say of them. judged: the same of the fit with what
    is needed; `before` itself where nothing is. small: effects that are certain but within the tolerance, or like all
    others too small for a cause. decoys: beside what is chosen; None without effects. drift: m by which the declared
    parameters alone certainly change over the session.

    For the rules: of_all: m of excess that all effects leave of trials left out. most: the fit with most effects; what
    goes one after another must not add up, so fits with fewer are compared with it. asked: effects that a fit without
    them lost; with fewer others beside it, that loses all the more. beside: whether `plain` began beside an effect too.
    """

    everything: Fit
    before: Judged
    judged: Judged
    of_all: float = 0.0
    small: tuple[str, ...] = ()
    decoys: Decoys | None = None
    drift: float = 0.0
    most: Judged | None = None
    asked: tuple[str, ...] = ()
    beside: bool = False

    @property
    def chosen(self) -> Fit:
        """Return the fit with what is needed."""
        return self.judged.fit

    @property
    def plain(self) -> Fit:
        """Return the fit of the declared parameters alone."""
        return self.before.fit

    @property
    def folds(self) -> Sequence[int]:
        """Return the fold of each trial."""
        return self.judged.folds

    @property
    def floor(self) -> float:
        """Return the noise, m."""
        return self.judged.floor

    @property
    def gains(self) -> dict[str, Gain]:
        """Return by each effect chosen what trials left out gain by it."""
        return self.judged.gains

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the effects chosen that are causes, the one whose absence costs most first."""
        causes = [label for label in self.gains if is_cause(self.chosen, label)]
        return tuple(sorted(causes, key=lambda label: -self.gains[label][0]))

    @property
    def slight(self) -> tuple[str, ...]:
        """Return the effects chosen that are too small for a cause: trials left out gain by them beside one."""
        causes = self.labels
        return tuple(label for label in self.gains if label not in causes)

    @property
    def reference(self) -> Judged:
        """Return the fit with most effects."""
        return self.most or self.judged

    def without(self, judged: Judged, dropped: Sequence[str]) -> "Selection":
        """Return the selection with a fit that has fewer effects."""
        small = (*self.small, *dropped)
        return replace(self, judged=judged, most=self.reference, small=small, decoys=None)

    def none(self, dropped: Sequence[str]) -> "Selection":
        """Return the selection of no effect."""
        return replace(self, judged=self.before, small=(*self.small, *dropped), decoys=None)


class Refits:
    """Fits with fewer effects than another, of a set's motions or a bench's records, that rules ask for. By default a
    method holds of a bench: it has no other layouts and no decoys."""

    tolerance: float  # m of excess, or in the bench's unit
    say: Callable[[str], None] = staticmethod(lambda line: None)

    def judged(self, fit: Fit) -> Judged:
        """Return a fit with what trials left out say of it."""
        raise NotImplementedError

    def without(self, known: Fit, labels: Sequence[str]) -> Fit:
        """Return a fit of the effects of another but `labels`."""
        raise NotImplementedError

    def alone(self, known: Fit, plain: Fit) -> Fit:
        """Return the fit of the declared parameters, begun beside the effects of a fit too."""
        return plain

    def decoys(self, known: Fit, everything: Fit) -> Decoys:
        """Return effects by chance beside a fit."""
        return Decoys((), ())

    def matters_elsewhere(self, fit: Fit, label: str) -> bool:
        """Return whether other layouts tell, to first order, that an effect is there."""
        return False

    def needed_elsewhere(self, known: Fit, simpler: Fit) -> bool:
        """Return whether the data lose by a simpler fit, and other layouts move otherwise."""
        return False


Step = Callable[[Refits, Selection], Selection | None]


@dataclass(frozen=True)
class Rule:
    """A rule that makes a selection smaller. threshold: what it asks for. origin: where that comes from."""

    name: str
    threshold: str
    origin: str
    step: Step


def follow(rules: Sequence[Rule], refits: Refits, selection: Selection) -> Selection:
    """Return what rules leave of a selection, each time by the first of them that has something to say."""
    last_line = ""
    while selection.gains:
        gains = ", ".join(f"{label} {in_mm(gain):.2f}" for label, (gain, _) in selection.gains.items())
        line = f"mm of excess that trials left out gain by each: {gains}; least {in_mm(least(refits, selection)):.2f}"
        if line != last_line:
            refits.say(last_line := line)
        after = next((s for rule in rules if (s := rule.step(refits, selection)) is not None), None)
        if after is None or after.chosen is after.plain:
            return after or selection
        selection = after
    return selection.none(selection.chosen.vector.labels)


def least(refits: Refits, selection: Selection) -> float:
    """Return what trials left out must gain by an effect, m: the tolerance, what one decoy in twenty gains, and beside
    a stronger effect more than is left, by those that stay or by all: where its law is not quite right, small ones
    take up what it lacks."""
    chance = 0.0 if selection.decoys is None else selection.decoys.chance
    if len(selection.gains) == 1:
        return max(refits.tolerance, chance)
    return max(refits.tolerance, chance, min(selection.of_all, selection.judged.excess))


def below(
    judged: Judged,
    asked: Sequence[str],
    limit: float,
    stays: Callable[[Sequence[str], str], bool],
) -> list[str]:
    """Return the effects of those `asked` that trials left out gain less by than `limit` [m], or not for certain, to
    first order, one after another, the least first. stays: of those that are off and one more, whether that is not
    dropped for another reason."""
    weak = list[str]()
    while True:
        gains = judged.gains_without(weak, [label for label in asked if label not in weak])
        rising = sorted(gains, key=lambda label: gains[label][0])
        for label in rising:
            if not is_certain(gains[label], limit) and not stays(weak, label):
                weak.append(label)
                break
        else:
            return weak


def loses(refits: Refits, most: Judged, simpler: Judged, limit: float, *, cause: bool) -> bool:
    """Return whether a fit with fewer effects does not do as well. As well: trials left out lose under `limit` [m], or
    not for certain, and, where what it lacks may be a `cause`, either the data lose too little, or other layouts differ
    by less than the tolerance."""
    return most.predicts_better(simpler, limit) or (cause and refits.needed_elsewhere(most.fit, simpler.fit))


def begin_beside(refits: Refits, selection: Selection) -> Selection | None:
    """Fit the declared parameters from beside the one effect that is left: what one of their false minima leaves is
    nothing that an effect explains."""
    if len(selection.gains) > 1 or selection.beside:
        return None
    return replace(selection, before=refits.judged(refits.alone(selection.chosen, selection.plain)), beside=True)


def too_little(refits: Refits, selection: Selection) -> Selection | None:
    """Drop the effects that trials left out gain too little by, to first order: as many as a fit without them loses
    nothing by. One stays to be asked alone. Of several the least is asked all the same: where each makes up for what
    another does, none seems to be spare to first order."""
    judged, limit, labels = selection.judged, least(refits, selection), selection.chosen.vector.labels

    def stays(off: Sequence[str], label: str) -> bool:
        last = 0 < len(off) == len(labels) - 1
        return last or (is_cause(judged.fit, label) and refits.matters_elsewhere(judged.fit, label))

    idle = [label for label in labels if label not in judged.parts]
    weak = idle or below(judged, [label for label in labels if label not in selection.asked], limit, stays)
    if not weak and len(labels) > 1 and not selection.asked:
        weak = [min(labels, key=lambda label: judged.gains[label][0])]
    if not weak:
        return None
    if len(labels) == 1:
        return selection.none(weak)
    while True:
        simpler = refits.judged(refits.without(judged.fit, weak))
        cause = any(is_cause(judged.fit, label) for label in weak)
        if idle or not loses(refits, selection.reference, simpler, limit, cause=cause):
            return selection.without(simpler, weak)
        if len(weak) == 1:
            return replace(selection, asked=(*selection.asked, *weak))
        weak = weak[: (len(weak) + 1) // 2]


def by_chance(refits: Refits, selection: Selection) -> Selection | None:
    """Ask for more than one decoy in twenty gains."""
    if selection.decoys is not None:
        return None
    decoys = refits.decoys(selection.chosen, selection.everything)
    more = decoys.chance > least(refits, selection)
    return replace(selection, decoys=decoys, asked=() if more else selection.asked)


def no_cause(refits: Refits, selection: Selection) -> Selection | None:
    """Drop the slightest effect where none is a cause: what is next to nothing shows only where a cloth is about to
    snap, and there as much as anything."""
    known, labels = selection.chosen, [*selection.gains]
    if any(is_cause(known, label) for label in labels):
        return None
    weak = min(labels, key=partial(strength, known))
    refits.say(f"{weak} is {strength(known, weak):.2f} of what is usual: no cause")
    if len(labels) == 1:
        return selection.none([weak])
    simpler = refits.judged(refits.without(known, [weak]))
    return replace(selection.without(simpler, [weak]), most=simpler, asked=())


_TOO_LITTLE = Rule(
    "gains too little",
    "the tolerance; beside a stronger effect what is left of trials left out",
    "asked for with --tolerance; small effects take up what a stronger one's law lacks",
    too_little,
)
ON_BENCHES = (_TOO_LITTLE,)
ON_SETS = (
    Rule("begin beside", "one effect is left", "false minima of the declared parameters", begin_beside),
    _TOO_LITTLE,
    Rule(
        "by chance", f"the {CHANCE:.0%} quantile of decoys' gains", "target-decoy competition, Elias and Gygi 2007",
        by_chance,
    ),
    Rule("no cause", f"{CAUSE:g} of the prior's deviation", "what is less is in any careful build", no_cause),
)  # fmt: skip
