"""A forward model whose batches are computed on other machines."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Column
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.runtime.cluster import TASKS, Cluster
from sim.chunks import BLOCKS
from sim.kernels.fields import LANES

Model = TypeVar("Model")
_Task = tuple[Any, str, list[Case], list[Any]]  # model, method, cases, what else it takes


@dataclass(frozen=True)
class OnCluster:
    """`model` on the workers of a cluster. Implements fabdesign.nouns.forward.ForwardModel.

    A task is a batch that fills lanes: LANES times as many designs as a worker has threads, up to BLOCKS times. A
    design's bits depend neither on those beside it nor on the worker. model: travels by value, with the designs.
    """

    model: ForwardModel
    cluster: Cluster

    def motions(self, cases: Sequence[Case], times: Sequence[Array]) -> list[NDArray[np.float32]]:
        return self.ask("motions", cases, times, instants=times)

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        return self.ask("equilibria", cases)

    def ask(
        self,
        method: str,
        cases: Sequence[Case],
        each: Sequence[Any] | None = None,
        *,
        columns: Sequence[Column] | None = None,
        instants: Sequence[Array] | None = None,
    ) -> list[Any]:
        """Return what `method` of the model gives, a result for each case, of what goes with `each`, by the same
        columns. instants: by which cases are alike. Raises SimulationError where a batch killed two workers."""
        if not cases:
            return []
        parts = batches(cases, instants, workers=self.cluster.workers, threads=self.cluster.threads)
        tasks = [
            (
                self.model,
                method,
                [cases[i] for i in part],
                [
                    *([] if each is None else [[each[i] for i in part]]),
                    *([] if columns is None else [columns]),
                ],
            )
            for part in parts
        ]
        results: list[Any] = [None] * len(cases)
        for part, answers in zip(parts, self.cluster.map(_answer, tasks, _named), strict=True):
            for i, result in zip(part, answers, strict=True):
                results[i] = result
        return results


def batches(cases: Sequence[Case], times: Sequence[Array] | None, *, workers: int, threads: int) -> list[list[int]]:
    """Return indices of the cases of each task, those alike together: TASKS tasks for each worker, as far as they fill
    its lanes and have room in its fields."""

    def kind(i: int) -> tuple:
        case, ends = cases[i], () if times is None else (len(times[i]), *times[i][-1:])
        return repr(case.design.fabric.hung), [term.name for term in case.effects], ends, len(case.program.time), i

    order = sorted(range(len(cases)), key=kind)
    least, most = LANES * min(threads, BLOCKS), LANES * BLOCKS
    size = min(most, least * -(-len(order) // (TASKS * workers * least)))
    return [order[k : k + size] for k in range(0, len(order), size)]


def _answer(task: _Task) -> list[Any]:
    """Return what the model answers, on a worker."""
    model, method, cases, further = task
    asked = getattr(model, method)
    answers: list[Any] = asked(cases, *further)
    return answers


def _named(task: _Task) -> str:
    cases = task[2]
    names = list(dict.fromkeys(case.design.name for case in cases))
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return f"a batch of {len(cases)} motions of {', '.join(names[:8])}{more}"
