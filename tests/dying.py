"""A forward model that ends the process in which it runs: once, or whenever it meets a certain design."""

import os
import signal
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fabdesign.errors import InputError
from fabdesign.nouns.forward import Case
from tests.analytic_cloth import AnalyticCloth


@dataclass(frozen=True)
class Dying:
    """once: a file that says that it died. design: by name, for which it always dies."""

    once: Path | None = None
    design: str = ""

    def equilibria(self, cases: Sequence[Case]) -> list[np.ndarray]:
        if self.once is not None and not self.once.exists() and len(cases) > 1:
            self.once.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if any(case.design.name == self.design for case in cases):
            os.kill(os.getpid(), signal.SIGKILL)
        return AnalyticCloth().equilibria(cases)

    def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        return AnalyticCloth().motions(cases, times)


def refuse(task: int) -> None:
    raise InputError("expected as many")
