"""The next experiment: the pressure program under which the explanations that remain differ most."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, ForwardModel, Term
from fabdesign.nouns.pressure import USUAL_LIMITS, RigLimits, regulated, standard_programs
from fabdesign.units import in_kpa, in_mm
from optimize.fit.parameters import FitVector

LEAST_DIFFERENCE = 0.3e-3  # m RMS, under which no program tells explanations apart in one trial
_FRAMES = 16
_STEP = 0.5  # prior standard deviations, of the differences by the declared parameters


@dataclass(frozen=True, eq=False)
class Explanation:
    """A fitted model that the data leave possible. instead_of: the effect chosen in whose place its last term is."""

    name: str
    vector: FitVector
    x: Array
    instead_of: str = ""

    @property
    def term(self) -> Term:
        """Return its last term."""
        return self.vector.terms_at(self.x)[-1]


def next_experiment(
    design: Design,
    forward: ForwardModel,
    explanations: Sequence[Explanation],
    noise: float,
    rig: RigLimits = USUAL_LIMITS,
) -> Mapping[str, Any] | None:
    """Return the program and how well it separates the explanations: expected_gain is the least RMS distance [mm]
    between two that the declared parameters could not take. None for fewer than two, and where no program does.

    noise: m, a frame's; not more than what it hides is claimed. Raises nothing: motions that diverge do not count.
    """
    if len(explanations) < 2:
        return None
    tried = standard_programs(design, rig)
    times = np.linspace(rig.duration / _FRAMES, rig.duration, _FRAMES)
    first = explanations[0]
    factors = np.flatnonzero(first.vector.are_factors).tolist()
    cases: list[Case] = []
    for program in tried.values():
        cases += [Case(design, program, e.vector.factors_at(e.x), e.vector.terms_at(e.x)) for e in explanations]
        for k in factors:
            x = first.x + _STEP * first.vector.prior[k] * np.eye(len(first.x))[k]
            cases.append(Case(design, program, first.vector.factors_at(x), first.vector.terms_at(x)))
    motions = forward.motions(cases, [times] * len(cases))
    count = len(explanations) + len(factors)
    best, gain = "", 0.0
    for k, name in enumerate(tried):
        separated = _separated(motions[k * count : (k + 1) * count], len(explanations))
        if separated > gain:
            best, gain = name, separated
    if gain < max(LEAST_DIFFERENCE, 0.3 * noise):
        return None
    program = tried[best]
    return {
        "program": {
            "what": best,
            "design": design.name,
            "duration_s": program.duration,
            "time_s": program.time.tolist(),
            "pressure_kpa": in_kpa(regulated(program.pressure, rig.resolution)).tolist(),
        },
        "separates": [e.name for e in explanations],
        "expected_gain": in_mm(gain),
    }


def _separated(motions: Sequence[NDArray[Any]], count: int) -> float:
    """Return the least distance, m RMS, of two explanations, less what declared parameters take within their prior."""
    flat = [np.asarray(m[:, ::8], dtype=float).ravel() for m in motions]
    if not all(np.isfinite(f).all() for f in flat):
        return 0.0
    slopes = np.stack([(f - flat[0]) / _STEP for f in flat[count:]], axis=1)
    ridge = slopes.T @ slopes + 1e-3**2 * len(flat[0]) / 3 * np.eye(slopes.shape[1]) / 4
    least = np.inf
    for i in range(count):
        for j in range(i):
            apart = flat[i] - flat[j]
            remaining = apart - slopes @ np.linalg.solve(ridge, slopes.T @ apart)
            least = min(least, float(np.sqrt(3 * np.mean(remaining**2))))
    return least
