"""The search: screen many starts, follow the best side by side, finish the best of those on the full model.

Every forward evaluation is part of a batch: the screening, and in a round the trial steps of all searches with the
finite differences around them. A round of a search is a linear model of the shape, NLopt's best step on it, and that
step tried at several lengths at once. Nothing depends on time or order, so that a seed gives one result.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fabdesign.forward import ForwardModel
from optimize.design_space import DesignSpace, Vector
from optimize.history import Entry, History
from optimize.local_search import LocalSearch
from optimize.objective import Objective, Shape

Point = tuple[int, Vector]  # the number of the start, for its space, and the vector

BATCH = 32  # designs a forward call: twice the simulator's lanes
PENALTY = 1.0  # m, for a diverged design, or twice the worst seen: worse than all others, and finite
INTERRUPTED = "interrupted; the same command goes on from here"


@dataclass(frozen=True)
class Stage:
    """The best `keep` of what came before go on for up to `rounds` rounds each, on this forward model.

    No round begins after the share `until` of the search's seconds, so that a slow machine gets to the last stage too.
    slopes: a cheaper model of the same shape that finite differences are taken on; `forward` itself by default.
    """

    name: str
    forward: ForwardModel
    keep: int
    rounds: int
    vary_positions: bool = False
    until: float = 1.0
    slopes: ForwardModel | None = None


@dataclass(frozen=True, eq=False)
class Best:
    start: int
    x: Vector
    value: float  # m, on the forward model of the stage
    stage: int


class Stop(Exception):
    """A limit is reached; the text says which."""


class Search:
    """Runs the stages within limits and keeps the best so far in `best`, whatever ends it.

    The first stage screens the starts, (space, vector) each. `seconds` includes the earlier sessions of `history`: the
    same search on the same history goes on after the last round that was finished, and ends where it would have ended.
    """

    def __init__(
        self,
        objective: Objective,
        starts: Sequence[tuple[DesignSpace, Vector]],
        stages: Sequence[Stage],
        history: History,
        *,
        seconds: float,
        evaluations: int,
        on_progress: Callable[["Search"], None] = lambda _: None,
    ) -> None:
        self.stages, self.history = stages, history
        self.best: Best | None = None
        self.stage = "start"  # under way
        self._objective, self._starts, self._on_progress = objective, starts, on_progress
        self._seconds, self._evaluations = seconds, evaluations
        self._began = time.monotonic() - history.seconds
        self._pace: dict[tuple[int, int, bool], float] = {}  # s that a batch of a size took last in a stage

    @property
    def elapsed(self) -> float:
        """s spent, earlier sessions of this history included."""
        return time.monotonic() - self._began

    def best_point(self) -> tuple[DesignSpace, Vector]:
        """The best so far; before the first evaluation, the first start."""
        if self.best is None:
            return self._starts[0]
        return self._space(self.best.start, self.stages[self.best.stage]), self.best.x

    def run(self) -> str:
        """Why it ended, as a sentence."""
        try:
            at, searches = self._load()
            for number in range(at, len(self.stages)):
                if number > at or not searches:
                    searches = self._enter(number, searches or self._screen())
                    self._save(number, searches)
                end = self.stages[number].until * self._seconds
                while (going := [s for s in searches if not s.done]) and (self.elapsed < end or end == self._seconds):
                    self._round(number, going)
                    self._save(number, searches)
        except Stop as stop:
            return str(stop)
        except KeyboardInterrupt:
            return INTERRUPTED
        return "converged: no search promises a further gain"

    def _space(self, start: int, stage: Stage) -> DesignSpace:
        return replace(self._starts[start][0], vary_positions=stage.vary_positions)

    def _screen(self) -> list[LocalSearch]:
        stage = self.stages[0]
        spaces = [self._space(i, stage) for i in range(len(self._starts))]
        xs = [own.encode(*space.decode(x)) for own, (space, x) in zip(spaces, self._starts, strict=True)]
        values = self._evaluate(0, list(enumerate(xs)))
        return [LocalSearch(i, spaces[i], xs[i], value, shape=shape) for i, (value, shape) in enumerate(values)]

    def _enter(self, number: int, searches: list[LocalSearch]) -> list[LocalSearch]:
        """The best go on in the stage's space, valued by its forward model.

        They are distinct, and at most half of them have one count of muscles where there are several: few muscles
        come near a target soon, more come nearer later.
        """
        stage = self.stages[number]
        kept: list[LocalSearch] = []
        counts = [len(s.space.design.muscles) for s in searches]
        most = stage.keep if len(set(counts)) == 1 else (stage.keep + 1) // 2
        for search in sorted(searches, key=lambda s: s.value):
            alike = sum(len(k.space.design.muscles) == len(search.space.design.muscles) for k in kept)
            if len(kept) < stage.keep and alike < most and all(search.distinct(other) for other in kept):
                kept.append(search)
        spaces = [self._space(s.start, stage) for s in kept]
        xs = [space.encode(*s.space.decode(s.x)) for space, s in zip(spaces, kept, strict=True)]
        values = self._evaluate(number, [(s.start, x) for s, x in zip(kept, xs, strict=True)])
        moved = [
            search.enter(space, x, value, shape)
            for search, space, x, (value, shape) in zip(kept, spaces, xs, values, strict=True)
            if np.all(np.isfinite(shape))
        ]
        if not moved:
            raise Stop("every design diverged")
        for search in moved:
            search.done = stage.rounds == 0
        return moved

    def _round(self, number: int, searches: list[LocalSearch]) -> None:
        self._find_slopes(number, [s for s in searches if s.model is None])
        trials, wanted = [], []
        stage = self.stages[number]
        for search in searches:
            self._require_time()
            xs = search.trials(self._objective)
            trials.append(xs)
            ahead = xs and search.rounds < stage.rounds - 1 and stage.slopes is None
            wanted.append(xs + (search.differences(xs[0]) if ahead else []))
        for search, xs, found in zip(searches, trials, self._evaluate_all(number, searches, wanted), strict=True):
            search.accept(self._objective, xs, found[: len(xs)], [shape for _, shape in found[len(xs) :]])
            search.done = search.done or search.rounds >= stage.rounds

    def _find_slopes(self, number: int, searches: list[LocalSearch]) -> None:
        bare = [s for s in searches if s.shape is None]
        for search, [(_, shape)] in zip(bare, self._evaluate_all(number, bare, [[s.x] for s in bare]), strict=True):
            search.shape = shape
        cheap = self.stages[number].slopes
        wanted = [s.lacks(known=cheap is None) for s in searches]
        for search, found in zip(searches, self._evaluate_all(number, searches, wanted, cheap), strict=True):
            search.linearise([shape for _, shape in found])

    def _evaluate_all(
        self, number: int, searches: list[LocalSearch], xs: list[list[Vector]], cheap: ForwardModel | None = None
    ) -> list[list[tuple[float, Shape]]]:
        """Each search's own vectors, all in common batches; on the stage's model, or on `cheap`."""
        flat = [(search.start, x) for search, own in zip(searches, xs, strict=True) for x in own]
        results = iter(self._evaluate(number, flat, cheap))
        return [[next(results) for _ in own] for own in xs]

    def _evaluate(
        self, number: int, points: Sequence[Point], cheap: ForwardModel | None = None
    ) -> list[tuple[float, Shape]]:
        """Value [m] and shape of every point; each is recorded, and becomes `best` where it is, unless on `cheap`."""
        results: list[tuple[float, Shape]] = []
        while len(results) < len(points):
            left = self._evaluations - self.history.evaluations
            if left <= 0:
                raise Stop(f"the limit of {self._evaluations} evaluations is reached")
            batch = points[len(results) : len(results) + min(BATCH, left)]
            self._require_time(self._pace.get((number, len(batch), cheap is None), 0.0))
            begin = self.elapsed
            results += self._evaluate_batch(number, batch, cheap)
            self._pace[number, len(batch), cheap is None] = self.elapsed - begin
            self._on_progress(self)
        return results

    def _require_time(self, needed: float = 0.0) -> None:
        if self.elapsed + needed > self._seconds:
            raise Stop(f"the limit of {self._seconds:g} s is reached")

    def _evaluate_batch(
        self, number: int, batch: Sequence[Point], cheap: ForwardModel | None
    ) -> list[tuple[float, Shape]]:
        stage = self.stages[number]
        self.stage = stage.name
        spaces = [self._space(start, stage) for start, _ in batch]
        points = [(space, x) for space, (_, x) in zip(spaces, batch, strict=True)]
        shapes = self._objective.shapes(cheap or stage.forward, points)
        found = [self._objective.value(shape) for shape in shapes]
        penalty = max(PENALTY, 2 * max([self.history.worst, *(v for v in found if np.isfinite(v))]))
        values = [v if np.isfinite(v) else penalty for v in found]
        seconds = self.elapsed
        self.history.add(
            Entry(
                seconds,
                stage.name if cheap is None else f"{stage.name}, slopes",
                value,
                not np.isfinite(raw),
                tuple(map(float, x)),
            )
            for value, raw, (_, x) in zip(values, found, batch, strict=True)
        )
        for value, space, (start, x) in zip(values, spaces, batch, strict=True) if cheap is None else ():
            known = self.best is not None and self.stages[self.best.stage].forward is stage.forward
            if space.feasible(x) and not (known and self.best is not None and self.best.value <= value):
                self.best = Best(start, x.copy(), value, number)
        return list(zip(values, shapes, strict=True))

    def _save(self, number: int, searches: list[LocalSearch]) -> None:
        found = self.best
        best = None if found is None else [found.start, found.x.tolist(), found.value, found.stage]
        rows = [
            [
                s.start,
                s.x.tolist(),
                s.value,
                s.radius,
                s.rounds,
                s.done,
                None if s.slopes_at is None else s.slopes_at.tolist(),
            ]
            for s in searches
        ]
        self.history.save({"stage": number, "best": best, "searches": rows}, self.elapsed)

    def _load(self) -> tuple[int, list[LocalSearch]]:
        state: Any = self.history.load()
        if state is None:
            return 0, []
        if state["best"] is not None:
            start, x, value, at = state["best"]
            self.best = Best(start, np.array(x), value, at)
        stage = self.stages[state["stage"]]
        searches = [
            LocalSearch(
                start,
                self._space(start, stage),
                np.array(x),
                value,
                radius,
                rounds,
                done,
                slopes_at=None if slopes_at is None else np.array(slopes_at),
            )
            for start, x, value, radius, rounds, done, slopes_at in state["searches"]
        ]
        return state["stage"], searches
