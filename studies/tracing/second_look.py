"""A second look at a round: effects fitted beyond first order, from the refit and from the data sheet."""

from functools import partial

import numpy as np

from studies.tracing.descent import descend
from studies.tracing.dictionary import starts_of
from studies.tracing.fit import State, loss
from studies.tracing.full_fit import (
    SHORT,
    STARTS,
    Finalist,
    Ranked,
    Task,
    entering,
    finalist_of,
    fit_from,
    fit_on,
    fitted,
    told,
)
from studies.tracing.screen import Start, starts_from_sheet
from studies.tracing.vector import Added

PROMISING = 10.0  # of log likelihood, that an effect must gain to count
SHORT_FITS = 3  # from either place
FROM_RANKING, FROM_SHEET = 1, 2  # of them that go on to their end


def beyond_first_order(task: Task, at: Ranked) -> list[Finalist]:
    """Where differences at the state say little: of the first in the ranking, fitted from there, and of those that
    promise most at the data sheet, fitted from there, what explains the residuals better than chance.

    The two are chosen from apart: after a few iterations from the data sheet a fit is still falling, and may be above
    one that has stood still near the refit, though the better minimum is on its way."""
    task.say(f"round {at.number + 1}: effects beyond first order, and at the data sheet")
    before = loss(task.bench, at.state)
    near = [(e, s) for e, s in _from_ranking(task, at) if before - loss(task.bench, s) > PROMISING]
    best: dict[str, State] = {}
    for place, fits, most in (("", near, FROM_RANKING), ("_sheet", _from_sheet(task, at), FROM_SHEET)):
        for effect, state in sorted(fits, key=lambda pair: loss(task.bench, pair[1]))[:most]:
            stage = f"on_{at.label}{place}_{effect}"
            found = fitted(task.bench, task.stages, stage, state.vector, partial(fit_on, task, effect, state))
            if effect not in best or loss(task.bench, found) < loss(task.bench, best[effect]):
                best[effect] = found
    promising = {e: s for e, s in best.items() if before - loss(task.bench, s) > PROMISING}
    return [finalist_of(task, at, state) for state in promising.values()]


def _from_ranking(task: Task, at: Ranked) -> list[tuple[str, State]]:
    fits = []
    for candidate in at.ranking.candidates[:SHORT_FITS]:
        added, begin, vector = entering(task, at, candidate)
        fit = partial(fit_from, task, at, at.state.x, vector, starts_of(added, begin, STARTS), SHORT)
        stage = f"ranked_{at.label}_{candidate.effect}"
        fits.append((candidate.effect, fitted(task.bench, task.stages, stage, vector, fit)))
    return fits


def _from_sheet(task: Task, at: Ranked) -> list[tuple[str, State]]:
    fits = []
    for start in _kept_starts(task, at)[:SHORT_FITS]:
        vector = at.state.vector.with_effect(start.added)
        say = told(task, f"{start.effect} from the data sheet,")
        fit = partial(descend, task.bench, vector, start.x, iterations=SHORT, progress=say)
        fits.append((start.effect, fitted(task.bench, task.stages, f"short_{at.number}_{start.effect}", vector, fit)))
    return fits


def _kept_starts(task: Task, at: Ranked) -> list[Start]:
    rows = task.stages.text(
        f"starts_{at.number}",
        lambda: [
            [s.effect, list(s.added.free), dict(s.added.fixed), s.added.scope, s.x.tolist(), s.expected]
            for s in starts_from_sheet(task.bench, at.state, task.types, task.channels, task.known)
        ],
    )
    return [
        Start(name, Added(name, tuple(free), fixed, scope), np.array(x), expected)
        for name, free, fixed, scope, x, expected in rows
    ]
