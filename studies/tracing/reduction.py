"""This module reduces the joint fit to what the data need, as many effects at a time as first order allows.

Cloths that snap make a long step lose its way: where many effects whose parts nearly cancel go at once, the fit without
them begins far off and ends at a false minimum, at which effects that are there gain nothing.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from fabdesign.geometry.metrics import over
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Term
from fabdesign.units import in_mm
from optimize.fit.descent import FitStart
from optimize.fit.fitted import Fit
from optimize.fit.misfit import capped
from optimize.fit.parameters import FitVector
from optimize.fit.policy import NEAR
from optimize.fit.significance import cheapest_first
from studies.tracing.task import Task


@dataclass(frozen=True, eq=False)
class Begin:
    """Where a fit without some effects begins. jacobian: (N, p) m, of the fit with them. rms, promised: m of residuals
    capped at 10 mm, as simulated and to first order."""

    vector: FitVector
    x: Array
    jacobian: Array
    rms: float
    promised: float


def reduced(task: Task, joint: Fit, labels: Collection[str]) -> tuple[Fit, list[str]]:
    """Return from where a fit of the terms `labels` alone may begin: the joint fit, or one without some other terms;
    and their labels there, with those of what must stay beside them.

    Where the tolerance more than first order promises is left without all the others, in quadrature, only half as many
    go at once, the cheapest first, and what stays is fitted before the next, by the joint fit's own Jacobian as long as
    that leads on. One that leaves more by itself, fitted too, stays."""
    known, wanted, stage = joint, _terms(joint, labels), 0
    while dropped := _cheapest_first(known, wanted):
        begin = begin_without(task, known, dropped)
        if _holds(task, begin):
            break
        while len(dropped) > 1 and not _holds(task, begin):
            dropped = dropped[: (len(dropped) + 1) // 2]
            begin = begin_without(task, known, dropped)
        stage += 1
        without = f"{in_mm(begin.rms):.3f} mm RMS without {', '.join(dropped)}"
        task.say(f"{without}; to first order {in_mm(begin.promised):.3f}")
        fitted = task.fit(f"fewer {stage}", begin.vector, FitStart(begin.x, begin.jacobian, known.inputs), NEAR)
        if over(fitted.after, begin.promised) > task.tolerance:
            wanted += _terms(known, dropped)
        else:
            known = fitted
    return known, _labels(known, wanted)


def begin_without(task: Task, known: Fit, labels: Collection[str]) -> Begin:
    """Return where a fit without the terms `labels` begins: the better of where the joint covariance says the others
    then are and where they are with them."""
    there = known.without(labels)
    vector, index = known.vector.only([label for label in known.vector.labels if label not in labels])
    rms, x = task.nearest(vector, [there[index], known.x[index]])
    return Begin(vector, x, known.state.jacobian[:, index], rms, promised(known, there))


def promised(known: Fit, there: Array) -> float:
    """Return the RMS of residuals capped at 10 mm, m, to first order, where a fit's unknowns are `there` (p,)."""
    return capped(known.state.misfit.residual + known.state.jacobian @ (there - known.x))


def _holds(task: Task, begin: Begin) -> bool:
    return over(begin.rms, begin.promised) <= task.tolerance


def _terms(known: Fit, labels: Collection[str]) -> list[Term]:
    """Return terms by label: a label changes where it is the last of its effect, its term does not."""
    return [term for label, term in zip(known.vector.labels, known.vector.terms, strict=True) if label in labels]


def _labels(known: Fit, terms: Sequence[Term]) -> list[str]:
    return [label for label, term in zip(known.vector.labels, known.vector.terms, strict=True) if term in terms]


def _cheapest_first(known: Fit, wanted: Sequence[Term]) -> list[str]:
    """Return the labels of all other terms, in the order in which they are dropped to first order."""
    kept = _labels(known, wanted)
    others = {label: known.vector.part(label) for label in known.vector.labels if label not in kept}
    return [name for name, *_ in cheapest_first(known.minimum, known.covariance, others)]
