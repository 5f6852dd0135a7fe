"""Other searches on the same simulator for the same target: random, and CMA-ES and TPE where they are installed."""

import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from benchmarks.search.parts import Row
from benchmarks.search.targets import Truth, measured
from optimize.search.design_space import DesignSpace, Vector
from optimize.search.evaluations import PENALTY
from optimize.search.margins import Limits
from optimize.search.objective import Objective, Target
from studies.layout_search.first_layouts import COARSE
from studies.study import simulator

BATCH = 32
TIMES = 5  # our seconds to there, that each has
DRAWS = 4000  # of a random layout that keeps the limits

Ask = Callable[[], list[Vector]]
Tell = Callable[[list[Vector], list[float]], None]


def baselines(truth: Truth, folder: Path, ours: float, goal: float) -> Row:
    """Seconds until each has a shape of `goal` m on the coarse model, null where it has none after TIMES `ours`: with
    as many muscles as the truth, of its types and on its faces, which ours is not told. What breaks a limit costs
    nothing, and is the worse the more it does."""
    target = Target(np.load(measured(truth, 0, folder))["points"])
    space = DesignSpace(truth.design, Limits(), truth.pressures[:1], vary_positions=True)
    coarse = simulator(COARSE, tolerance=1e-6)
    objective = Objective([target])
    objective.shapes(coarse, [(truth.design, truth.pressures[:1])])  # so that all is compiled
    row: Row = {"ours": {"seconds": ours}}
    for name, ask, tell in _others(space):
        begin, best, reached, count = time.monotonic(), np.inf, None, 0
        while time.monotonic() - begin < TIMES * ours and reached is None:
            xs = ask()
            kept = [space.feasible(x) for x in xs]
            shapes = iter(
                objective.shapes(coarse, [space.decode(x) for x, keeps in zip(xs, kept, strict=True) if keeps])
            )
            values = [
                objective.value(next(shapes)) if keeps else _violation(space, x)
                for x, keeps in zip(xs, kept, strict=True)
            ]
            values = [value if np.isfinite(value) else PENALTY for value in values]
            tell(xs, values)
            count += sum(kept)
            best = min(best, *values)
            reached = time.monotonic() - begin if best <= goal else None
        row[name] = {"seconds": reached, "best_mm": 1e3 * best, "evaluations": count}
    return row


def _violation(space: DesignSpace, x: Vector) -> float:
    """Worse than any shape, and by how many m the limits are broken."""
    return PENALTY - float(np.minimum(space.margins(x), 0.0).sum())


def _random(space: DesignSpace, rng: Generator) -> list[Vector]:
    """A batch that keeps the limits, as far as draws find one."""
    draws = (rng.random(space.dimension) for _ in range(DRAWS))
    return [*islice((x for x in draws if space.feasible(x)), BATCH)] or [rng.random(space.dimension)]


def _others(space: DesignSpace) -> Iterator[tuple[str, Ask, Tell]]:
    rng, size = np.random.default_rng(1), space.dimension
    yield "random", lambda: _random(space, rng), lambda xs, values: None
    if find_spec("cma"):
        import cma

        strategy = cma.CMAEvolutionStrategy(np.full(size, 0.5), 0.25, {"bounds": [0, 1], "popsize": BATCH, "seed": 1})
        yield "CMA-ES", strategy.ask, strategy.tell
    if find_spec("optuna"):
        yield ("TPE", *_tpe(size))


def _tpe(size: int) -> tuple[Ask, Tell]:
    import optuna

    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=1))
    asked: list[Any] = []

    def ask() -> list[Vector]:
        asked[:] = [study.ask() for _ in range(BATCH)]
        return [np.array([trial.suggest_float(str(k), 0, 1) for k in range(size)]) for trial in asked]

    def tell(xs: list[Vector], values: list[float]) -> None:
        for trial, value in zip(asked, values, strict=True):
            study.tell(trial, value)

    return ask, tell
