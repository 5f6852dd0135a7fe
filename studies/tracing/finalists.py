"""What explains a round's residuals, fitted in full inside the simulator."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from studies.tracing.fit import State, little, loss
from studies.tracing.full_fit import FAR, Finalist, Ranked, Task, finalist_of, in_full, without
from studies.tracing.ranking import ALIKE, Candidate, Grams, alike, excess_over
from studies.tracing.second_look import beyond_first_order
from studies.tracing.together import all_at_once
from studies.tracing.vector import FACTORS
from studies.tracing.verdict import GROSS

FINALISTS = 2  # that are fitted in full
CLOSE = 0.25  # of the excess: a third one is, where it gains that much less than the first at most
WORTH = 0.15  # of an excess, that a further effect must take
CLOSES = 0.5  # of the excess of the very trials fitted, that an effect must close whose gain no null was drawn for
LEFT = 0.25  # of what single ones leave, that all at once may leave at most, where it is much


@dataclass(frozen=True, eq=False)
class Tried:
    """What the first round has fitted beyond its ranking, where it is done again from a better state without any."""

    second_look: tuple[Finalist, ...] | None = None
    together: State | None = None

    @property
    def label(self) -> str:
        return "_again" * ((self.second_look is not None) + (self.together is not None))


@dataclass(frozen=True, eq=False)
class Better:
    """A state of the round's own model that leaves less than the round's."""

    state: State
    tried: Tried


def finalists_of(task: Task, at: Ranked, tolerance: float, tried: Tried) -> list[Finalist] | Better:
    """What explains a round's residuals, fitted in full: the best of the ranking; at first, where these leave more than
    the tolerance of the very trials fitted, what a second look finds; where that leaves much, all effects at once."""
    ranking, state = at.ranking, at.state
    worth = [c for c in ranking.candidates if ranking.certain(c) and c.gain > WORTH * ranking.excess]
    to_fit = _to_fit(at.grams, worth, ranking.excess)
    if at.number > 0:
        return [in_full(task, at, c, k) for k, c in enumerate(to_fit)]
    rest = [(k, c) for k, c in enumerate(to_fit) if k > 0]
    finalists = [in_full(task, at, c, 0) for c in to_fit[:1]]
    excess = in_sample_excess(task, state)

    def closing(some: Sequence[Finalist]) -> list[Finalist]:
        return [f for f in some if in_sample_excess(task, f.state) < (1 - CLOSES) * excess]

    astray = not worth or bool(np.abs(state.x[:FACTORS]).max() >= FAR)
    if tried.second_look is None and astray and excess > tolerance and not closing(finalists):
        looked = _looked_again(task, at, tried)
        if isinstance(looked, Better):
            return looked
        tried = looked
    there = {f.effects for f in finalists}
    second = tuple(finalist_of(task, at, f.state) for f in tried.second_look or () if f.effects not in there)
    finalists += closing(second)
    left = min([excess, *(in_sample_excess(task, f.state) for f in finalists)])
    if left > GROSS * tolerance:
        together = _together(task, at, tried, left, tolerance)
        if together is not None:
            return together if isinstance(together, Better) else [together]
    there = {f.effects for f in finalists}
    return finalists + [in_full(task, at, c, k) for k, c in rest if (c.effect,) not in there]


def _looked_again(task: Task, at: Ranked, tried: Tried) -> Tried | Better:
    """With the second look; a better state of the round's own model, where what it found leads to one."""
    looked = tuple(beyond_first_order(task, at))
    tried = replace(tried, second_look=looked)
    if looked:
        plain = without(task, at, min(looked, key=lambda f: f.held_out).state, "without")
        if _gains(task, at.state, plain):
            return Better(plain, tried)
    return tried


def _together(task: Task, at: Ranked, tried: Tried, left: float, tolerance: float) -> Finalist | Better | None:
    """All effects at once, where they leave little of what single ones `left` [m]; a better state likewise."""
    enough = min(max(LEFT * left, GROSS * tolerance), (1 - CLOSES) * left)
    found = tried.together
    if found is None:
        found, plain = all_at_once(task, at, float(np.hypot(enough, task.floor)))
        if _gains(task, at.state, plain):
            return Better(plain, replace(tried, together=found))
    if found is None or not found.vector.added or in_sample_excess(task, found) >= enough:
        return None
    return finalist_of(task, at, found, together=True)


def _gains(task: Task, state: State, other: State) -> bool:
    return loss(task.bench, state) - loss(task.bench, other) > little(task.bench)


def in_sample_excess(task: Task, state: State) -> float:
    """m, over the noise, of the trials that were fitted."""
    return float(excess_over(state.mean_square, task.floor))


def _to_fit(grams: Grams, worth: Sequence[Candidate], excess: float) -> list[Candidate]:
    """The best that are not the same answer to first order: two, and a third where it comes close."""
    chosen: list[Candidate] = []
    for candidate in worth:
        same = chosen and max(map(abs, alike(grams, candidate.best, [c.best for c in chosen]))) > ALIKE
        close = not chosen or chosen[0].gain - candidate.gain < CLOSE * excess
        if not same and (len(chosen) < FINALISTS or (len(chosen) == FINALISTS and close)):
            chosen.append(candidate)
    return chosen
