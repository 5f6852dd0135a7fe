"""Other searches on the same simulator for the same target: random, and CMA-ES and TPE where they are installed."""

import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.search.parts import Row
from benchmarks.search.targets import Truth, measured
from optimize.design_space import DesignSpace, Vector
from optimize.margins import Limits
from optimize.objective import Objective, Target
from studies.layouts.run import forward_models

BATCH = 32
TIMES = 5  # of our seconds, that each has

Ask = Callable[[], list[Vector]]
Tell = Callable[[list[Vector], list[float]], None]


def baselines(truth: Truth, folder: Path, seconds: float, near: float) -> Row:
    """Seconds until each has a value of `near` m, null where it has none by then: with as many muscles as the truth,
    on its faces, which ours is not told."""
    target = Target(np.load(measured(truth, 0, folder))["points"])
    space = DesignSpace(truth.design, Limits(), truth.pressures[:1], vary_positions=True)
    _, coarse = forward_models(None, None)
    objective = Objective([target])
    row: Row = {}
    for name, ask, tell in _others(space.dimension):
        begin, best, reached = time.monotonic(), np.inf, None
        while time.monotonic() - begin < TIMES * seconds and reached is None:
            xs = ask()
            sound = [x for x in xs if space.feasible(x)]
            shapes = objective.shapes(coarse, [(space, x) for x in sound])
            found = iter(objective.value(shape) for shape in shapes)
            values = [next(found) if space.feasible(x) else 1.0 for x in xs]
            values = [value if np.isfinite(value) else 1.0 for value in values]
            tell(xs, values)
            best = min(best, *values)
            reached = time.monotonic() - begin if best <= near else None
        row[name] = {"seconds": reached, "best_mm": 1e3 * best}
    return row


def _others(size: int) -> Iterator[tuple[str, Ask, Tell]]:
    rng = np.random.default_rng(1)
    yield "random", lambda: list(rng.random((BATCH, size))), lambda xs, values: None
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
