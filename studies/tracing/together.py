"""Every effect at once, from the data sheet; then those dropped again that the data do not need.

A large effect, or one of several, drives the refit far off: the declared parameters take what they can of it, and the
differences there say little of any effect by itself. Where all may act, the fit finds its way, and what is not there
comes out as nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from fabdesign.effects import EFFECTS, Effect
from studies.calibration.clouds import evenly
from studies.calibration.parameters import START
from studies.tracing.descent import descend
from studies.tracing.fit import Bench, State, loss, normal
from studies.tracing.full_fit import Ranked, Task, fitted, told, without
from studies.tracing.ranking import cross_validate, excess_of, gain_interval, grams_of, without_parameters
from studies.tracing.vector import FACTORS, Added, Array, Vector, place_of, scope_of

NEEDED = 10.0  # of log likelihood: an effect that costs less to drop is dropped
DOUBTFUL = 20.0  # the same to first order: it is tried
ITERATIONS, EARLY = 20, 3
TRIALS = 6  # with which all effects are fitted


def all_at_once(task: Task, at: Ranked, enough: float = np.inf) -> tuple[State, State]:
    """What the data need of all effects, and the round's own model fitted from there.

    From the data sheet with every effect, on some of the trials, to what these need; then on all trials, with the
    shapes free too, to what says something for certain of trials left out, and explains more than the model without
    any effect does, fitted from there. Where all effects leave more than `enough` [m RMS] the first of these is what
    is given back: fewer would leave more."""
    state = _needed_of_all(task, at, enough)
    plain = without(task, at, state, "plain")
    count = len(state.vector.added)
    explained = loss(task.bench, plain) - loss(task.bench, state) > NEEDED * count
    return (state if explained or state.rms > enough else plain), plain


def _needed_of_all(task: Task, at: Ranked, enough: float) -> State:
    task.say(f"round {at.number + 1}: all effects at once, from the data sheet")
    chosen = evenly(len(task.bench.samples), TRIALS).tolist()
    some = replace(
        task,
        bench=replace(task.bench, samples=[task.bench.samples[k] for k in chosen]),
        folds=[task.folds[k] for k in chosen],
    )
    vector = Vector(tuple(_every_effect(task)))
    x = np.concatenate([np.zeros(FACTORS), _begin(vector)])
    fit = partial(
        descend, some.bench, vector, x, iterations=ITERATIONS, early=EARLY, exact=False, progress=told(task, "all")
    )
    state = fitted(some.bench, task.stages, f"all_{at.label}", vector, fit)
    if state.rms > enough:
        return state
    state = needed(some, f"all_{at.label}", state, some.bench.observations / task.bench.observations)
    return _on_all_trials(task, at, state, shown=len(chosen))


def _on_all_trials(task: Task, at: Ranked, state: State, shown: int) -> State:
    """shown: how many trials the state was fitted to."""
    whole = Vector(tuple(_with_shapes(added) for added in state.vector.added))
    if shown < len(task.bench.samples) or whole.size > state.vector.size:
        x = _at(whole, state)
        fit = partial(descend, task.bench, whole, x, iterations=ITERATIONS, progress=told(task, "with shapes,"))
        state = fitted(task.bench, task.stages, f"whole_{at.label}", whole, fit)
        state = needed(task, f"whole_{at.label}", state)
    while state.vector.added:
        found = gains(task.bench, state, task.folds, task.floor)
        least = min(found, key=lambda name: found[name].interval90[0])
        if found[least].interval90[0] > 0:
            break
        state = refitted_without(task, f"whole_{at.label}", state, [least])
    return state


def needed(task: Task, stage: str, state: State, share: float = 1.0) -> State:
    """`state` without the effects that cost less than NEEDED each to drop, refitted. What is cheap to first order is
    dropped together, the cheapest of the others alone, for the fit without it to say. share: of all observations, that
    the task's are."""
    while dropped := droppable(task.bench, state, share):
        while True:
            found = refitted_without(task, stage, state, dropped)
            if loss(task.bench, found) - loss(task.bench, state) <= share * NEEDED * len(dropped):
                state = found
                break
            if len(dropped) == 1:
                return state
            dropped = dropped[: len(dropped) // 2]
    return state


def refitted_without(task: Task, stage: str, state: State, dropped: Sequence[str]) -> State:
    fewer = without_effects(state, dropped)
    names = [added.name for added in fewer.vector.added]
    task.say(f"without {', '.join(sorted(dropped))}: {', '.join(names) or 'no effect'} left")
    fit = partial(
        descend, task.bench, fewer.vector, fewer.x, iterations=ITERATIONS, slopes=fewer.jacobian,
        progress=told(task, f"{len(names)} effects"),
    )  # fmt: skip
    return fitted(task.bench, task.stages, f"{stage}_{'_'.join(names) or 'none'}", fewer.vector, fit)


def droppable(bench: Bench, state: State, share: float = 1.0) -> list[str]:
    """The effects that cost less than this share of NEEDED each, one after another, with all other parameters moving to
    first order along, the cheapest first; where there is none, the cheapest, if it costs less than that of DOUBTFUL,
    or the cheapest two, if they cost no more each: a lag and a clock that runs ahead make up for each other."""
    cost = partial(_cost, *normal(bench, state), state)
    parts = dict(zip((a.name for a in state.vector.added), state.vector.parts(), strict=True))
    dropped: list[str] = []
    paid = cost([])
    while left := [name for name in parts if name not in dropped]:
        costs = {name: cost([parts[n] for n in (*dropped, name)]) - paid for name in left}
        cheapest = min(costs, key=lambda name: costs[name])
        if costs[cheapest] >= share * (NEEDED if dropped else DOUBTFUL):
            break
        dropped.append(cheapest)
        paid += costs[cheapest]
    if dropped or len(parts) < 2:
        return dropped
    pairs = {pair: cost([parts[name] for name in pair]) - paid for pair in combinations(parts, 2)}
    cheapest_pair = min(pairs, key=lambda pair: pairs[pair])
    return list(cheapest_pair) if pairs[cheapest_pair] < share * 2 * DOUBTFUL else []


def _cost(gradient: Array, hessian: Array, state: State, dropped: Sequence[slice]) -> float:
    """The quadratic model's least value where the parameters of `dropped` are at zero; those at a bound stay there."""
    low, high = state.vector.bounds
    held = ((state.x <= low) & (gradient > 0)) | ((state.x >= high) & (gradient < 0))
    step = np.zeros(len(state.x))
    for part in dropped:
        held[part] = True
        step[part] = -state.x[part]
    free = np.flatnonzero(~held)
    slope = gradient + hessian @ step
    step[free] = -np.linalg.solve(hessian[np.ix_(free, free)], slope[free])
    return float(gradient @ step + 0.5 * step @ hessian @ step)


def without_effects(state: State, dropped: Sequence[str]) -> State:
    """The state with these effects off, its residuals as they were."""
    assert state.jacobian is not None
    kept = np.ones(len(state.x), dtype=bool)
    for added, part in zip(state.vector.added, state.vector.parts(), strict=True):
        kept[part] = added.name not in dropped
    vector = Vector(tuple(added for added in state.vector.added if added.name not in dropped))
    return replace(state, vector=vector, x=state.x[kept], jacobian=state.jacobian[:, kept])


@dataclass(frozen=True)
class Gain:
    """m of excess that trials left out gain by an effect of a state, to first order, and its 90 % interval."""

    gain: float
    interval90: tuple[float, float]


def gains(bench: Bench, state: State, folds: Sequence[int], floor: float) -> dict[str, Gain]:
    """By effect of the state."""
    grams = grams_of(bench, state, np.zeros((len(state.found.residual), 0)), folds)
    own = cross_validate(grams, None)
    rng = np.random.default_rng(0)
    found = {}
    for added, part in zip(state.vector.added, state.vector.parts(), strict=True):
        absent = cross_validate(without_parameters(grams, part), None)
        gain = excess_of(grams, absent, floor) - excess_of(grams, own, floor)
        found[added.name] = Gain(gain, gain_interval(grams, absent, own, floor, rng))
    return found


def _every_effect(task: Task) -> list[Added]:
    """With its strengths free and its shape typical; none of which something is to be chosen, such as a channel."""
    return [
        Added(effect.name, effect.strengths, _shape(effect), scope_of(effect.name, task.types))
        for effect in EFFECTS.values()
        if effect.name not in task.known and effect.strengths and not any(p.whole for p in effect.parameters.values())
    ]


def _shape(effect: Effect) -> dict[str, float]:
    """Typical values of what is no strength."""
    return {name: p.typical for name, p in effect.parameters.items() if p.off is None}


def _begin(vector: Vector) -> Array:
    """Where the effects begin: part of the way to what is typical, as in calibration."""
    return np.array([START * place_of(p, p.typical) for added in vector.added for p in added.declared])


def _with_shapes(added: Added) -> Added:
    effect = EFFECTS[added.name]
    fixed = {name: v for name, v in added.fixed.items() if effect.parameters[name].whole}
    return replace(added, free=tuple(name for name in effect.parameters if name not in fixed), fixed=fixed)


def _at(vector: Vector, state: State) -> Array:
    """The state's place in a vector of the same effects with more of their parameters."""
    x = [*state.x[:FACTORS]]
    for added, own, part in zip(vector.added, state.vector.added, state.vector.parts(), strict=True):
        values = own.values(state.x[part])
        x += [place_of(p, values[name]) for name, p in zip(added.free, added.declared, strict=True)]
    return np.array(x)
