"""The evaluations of a search: batches within its limits, all recorded, the best kept."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from fabdesign.nouns.column import Jacobians
from fabdesign.nouns.forward import ForwardModel
from fabdesign.runtime import working_time
from fabdesign.units import in_mm
from optimize.search.best import MARGIN, Best, BestSoFar, Stage
from optimize.search.design_space import DesignSpace, Vector
from optimize.search.history import Entry, History
from optimize.search.mirror import has_even_targets, is_even
from optimize.search.objective import Objective, Poses
from optimize.search.slopes import Slopes, jacobians_for, slopes_of

Point = tuple[int, Vector]  # the number of the start, for its space, and the vector

BATCH = 32  # designs a forward call: four times the simulator's lanes
FINALISTS = 3
SLOPES = ", slopes"  # what a stage's entries are called that serve derivatives alone
TIME_USED = "time used"  # how a reason to end begins that is the limit of seconds
PENALTY = 1.0  # m, for a diverged design, or twice the worst seen: worse than all others, and finite


class Stop(Exception):
    """A limit is reached; the text says which."""


class Evaluations:
    """Values designs on the stages' forward models within limits, and keeps the best so far in `best`.

    starts: (space, vector) each. `seconds` includes the earlier sessions of `history`. on_progress is told after every
    batch. limit: s that a message says, where `seconds` are a part of them.
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
        on_progress: Callable[["Evaluations"], None] = lambda _: None,
    ) -> None:
        self.starts, self.stages, self.history = [*starts], stages, history
        self.reached = BestSoFar(stages)
        self.restart_began = 0.0  # s of search, when the restart under way began
        self.stage = "start"  # under way
        self.message = ""  # for people, once there is something to tell
        self.objective, self._at_rest = objective, objective.at_rest
        self.even_targets = has_even_targets(objective)
        self._on_progress = on_progress
        self.seconds, self._most = seconds, evaluations
        self.limit = seconds
        self._began = working_time.seconds() - history.seconds
        self.noting = True  # whether what is evaluated may become `best`
        self._pace: dict[tuple[int, int, bool], float] = {}  # s that a batch of a size took last in a stage

    @property
    def elapsed(self) -> float:
        """Return s spent, earlier sessions of this history included."""
        return working_time.seconds() - self._began

    @property
    def best(self) -> Best | None:
        return self.reached.best

    @property
    def best_in_words(self) -> str:
        """Return the best so far for people; on the coarse model it may look better than it is."""
        if self.best is None:
            return "best none yet"
        where = "" if self.reached.is_full(self.best) else " on the coarse model"
        return f"best {in_mm(self.best.value):.3f} mm{where}"

    @property
    def share(self) -> float:
        """Return the share spent of the limit that is nearer: 0 to 1."""
        return min(1.0, max(self.elapsed / self.seconds, self.history.evaluations / self._most))

    def best_point(self) -> tuple[DesignSpace, Vector]:
        """Return the best so far; before the first evaluation, the first start."""
        return self.starts[0] if self.best is None else self.point(self.best)

    def nearest(self) -> Best | None:
        """Return the best, or where the targets are even an even layout that is as near."""
        if self.best is None or not self.even_targets:
            return self.best
        rivals = self.reached.within(MARGIN)
        return next((rival for rival in rivals if is_even(self.point(rival))), self.best)

    def finalists(self, most: int = FINALISTS) -> list[tuple[DesignSpace, Vector]]:
        """Return the nearest, and what other starts came to that is as near: another layout or other pressures."""
        first = self.nearest()
        points = [self.best_point() if first is None else self.point(first)]
        for rival in self.reached.within(self.reached.margin):
            point = self.point(rival)
            if first and rival.start != first.start and not any(_same(point, other) for other in points):
                points.append(point)
        return points[:most]

    def point(self, reached: Best) -> tuple[DesignSpace, Vector]:
        """Return where it lies."""
        return self.space(reached.start, reached.stage), reached.x

    def space(self, start: int, number: int) -> DesignSpace:
        """Return the start's, with the freedom that the stage of this number gives."""
        return replace(self.starts[start][0], vary_positions=self.stages[number].vary_positions)

    def may_begin(self, number: int) -> bool:
        """Return whether there is time for another round of the stage of this number."""
        until, began = self.stages[number].until, self.restart_began
        return until == 1.0 or self.elapsed < began + until * (self.seconds - began)

    def evaluate(
        self, number: int, points: Sequence[Point], cheap: ForwardModel | None = None
    ) -> list[tuple[float, Poses]]:
        """Return value [m] and shape of every point on the model of the stage of this number, or on `cheap`; each is
        recorded, and becomes `best` where it is, unless on `cheap`. Raises Stop."""
        results: list[tuple[float, Poses]] = []
        stage, objective, exact = self.stages[number], self.objective_of(number), cheap is None
        for batch in self._batches(points):
            self.require_time(self._expected(number, len(batch), exact))
            begin, self.stage = self.elapsed, stage.name
            placed = [(self.space(start, number), x) for start, x in batch]
            shapes = objective.shapes(cheap or stage.forward, [space.decode(x) for space, x in placed])
            values = self._record(stage.name + ("" if exact else SLOPES), batch, objective.values(shapes))
            for value, shape, (space, x), (start, _) in zip(values, shapes, placed, batch, strict=True):
                if not exact or not space.keeps(x, shape):
                    continue
                rival = Best(start, x.copy(), value, number)
                self.reached.count(rival, len(space.design.muscles))
                if self.noting:
                    self.reached.note(rival, shape)
            results += zip(values, shapes, strict=True)
            self._pace[number, len(batch), exact] = self.elapsed - begin
            self._on_progress(self)
        return results

    def _expected(self, number: int, size: int, exact: bool) -> float:
        """Return the seconds that a batch of a size is expected to take: as the smallest that was no smaller, else as
        the largest that was smaller; 0 before any."""
        known = {n: seconds for (stage, n, cheap), seconds in self._pace.items() if (stage, cheap) == (number, exact)}
        nearest = min(known, key=lambda n: (n < size, abs(n - size)), default=None)
        return 0.0 if nearest is None else known[nearest]

    def jacobians(self, number: int) -> Jacobians | None:
        """Return what derivatives a search of the stage of this number may ask for; None: it takes differences."""
        return jacobians_for(self.stages[number].slopes or self.stages[number].forward, self.objective_of(number))

    def objective_of(self, number: int) -> Objective:
        """Return what the stage of this number is valued by."""
        return self._at_rest if self.stages[number].at_rest else self.objective

    def slopes(self, number: int, points: Sequence[Point]) -> list[Slopes]:
        """Return how the shape of every point changes with its variables; recorded, but nothing of it becomes `best`.
        Raises Stop."""
        jacobians = self.jacobians(number)
        assert jacobians is not None
        slopes: list[Slopes] = []
        objective = self.objective_of(number)
        for batch in self._batches(points):
            self.require_time()
            new = slopes_of(jacobians, objective, [(self.space(start, number), x) for start, x in batch])
            self._record(self.stages[number].name + SLOPES, batch, objective.values([one.shape for one in new]))
            slopes += new
            self._on_progress(self)
        return slopes

    def _batches(self, points: Sequence[Point]) -> Iterator[Sequence[Point]]:
        """Yield points in batches, as many as there are evaluations left. Raises Stop where none are."""
        begin = 0
        while begin < len(points):
            remaining = self._most - self.history.evaluations
            if remaining <= 0:
                raise Stop(f"the limit of {self._most} evaluations is reached")
            batch = points[begin : begin + min(BATCH, remaining)]
            begin += len(batch)
            yield batch

    def require_time(self, needed: float = 0.0) -> None:
        """Raise Stop where less than `needed` s are left."""
        if self.elapsed + needed > self.seconds:
            part = f"the search's part, {self.seconds:g} of {self.limit:g} s,"
            what = part if self.seconds < self.limit else f"the limit of {self.limit:g} s"
            ends = "is reached" if self.elapsed >= self.seconds else "would be passed by the next step"
            raise Stop(f"{TIME_USED}: {what} {ends}")

    def set_down(self, reason: str = "") -> None:
        """Keep the best, and what was spent, at an end within a round. reason: of an end by a limit."""
        state = self.history.load()
        if state is not None and self.best is not None:
            state |= self.reached.rows()
            state["ended"] = [reason, self.seconds, self._most]
            self.history.save(state, self.elapsed)

    def ended(self) -> str:
        """Return why this history's search has ended by a limit, if it would end by the same one now; else empty."""
        state = self.history.load() or {}
        reason, seconds, most = state.get("ended", ["", 0.0, 0])
        return str(reason) if seconds >= self.seconds and most >= self._most else ""

    def _record(self, label: str, batch: Sequence[Point], computed: Sequence[float]) -> list[float]:
        """Return the values [m], a penalty for each that is none, as they stand in the history."""
        penalty = max(PENALTY, 2 * max([self.history.worst, *(v for v in computed if np.isfinite(v))]))
        values = [v if np.isfinite(v) else penalty for v in computed]
        seconds = self.elapsed
        self.history.add(
            Entry(seconds, label, value, not np.isfinite(raw), tuple(map(float, x)))
            for value, raw, (_, x) in zip(values, computed, batch, strict=True)
        )
        return values


def _same(one: tuple[DesignSpace, Vector], other: tuple[DesignSpace, Vector]) -> bool:
    """Return whether two are one layout under the same pressures, to 1 kPa."""
    (design, pressures), (known, others) = (space.decode(x) for space, x in (one, other))
    return design == known and bool(np.allclose(pressures, others, rtol=0, atol=1e3))
