"""The next experiment: the pressure program under which the explanations that remain differ most."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, ForwardModel, Term
from fabdesign.nouns.pressure import LEAST_HOLD, USUAL_LIMITS, PressureProgram, RigLimits, limits, regulated
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


def programs(design: Design, rig: RigLimits = USUAL_LIMITS) -> dict[str, PressureProgram]:
    """Return steps, staircases and ramps within the limits of the muscles and the rig: every channel alone in turn, one
    face, the other, all. Levels hold for LEAST_HOLD s, as far as the rig's duration allows it."""
    most, seconds = np.minimum(limits(design), rig.pressure), rig.duration
    levels, count = max(1, int(seconds / LEAST_HOLD)), len(most)
    stairs = 2 * int(np.clip(levels // 2, 2, 3))
    on = {(m.channel, m.side) for m in design.muscles}
    faces = {s: np.array([(c, s) in on for c in range(design.channels)]) for s in ("front", "back")}
    groups = {f"the {side}": where for side, where in faces.items() if where.any()}
    candidates: dict[str, PressureProgram] = {}
    for said, where in groups.items():
        p = np.where(where, most, 0.0)
        candidates[f"step of {said}, held"] = _rows([0.0], [p], seconds)
        candidates[f"step of {said} on and off"] = _rows([0.0, seconds / 2], [p, 0 * p], seconds)
        shares = 1 - np.abs(2 * np.arange(1, stairs + 1) / stairs - 1)
        times = np.arange(stairs) * seconds / stairs
        candidates[f"staircase of {said}, up and down"] = _rows(times, shares[:, None] * p, seconds)
        times = np.arange(60) * seconds / 60
        candidates[f"slow ramp of {said}, up and down"] = _rows(
            times, (1 - np.abs(times / seconds * 2 - 1))[:, None] * p, seconds
        )
    for channels in np.array_split(np.arange(count), -(-count // levels)) if count else ():
        which = "each channel" if count <= levels else f"channels {', '.join(map(str, channels))}"
        times = np.arange(len(channels)) * seconds / len(channels)
        candidates[f"{which} alone in turn"] = _rows(times, np.diag(most)[channels], seconds)
    both = np.tril(np.ones((count, count))) * most * 0.7
    candidates["one channel more at a time"] = _rows(np.arange(count) * seconds / count, both, seconds)
    return {name: program for name, program in candidates.items() if fastest(program) <= rig.rate * (1 + 1e-9)}


def fastest(program: PressureProgram) -> float:
    """Return the largest change of a set point over the time to the next, Pa/s; infinite for a step at 0 s."""
    if program.pressure[0].any():
        return float("inf")
    if len(program.time) < 2:
        return 0.0
    return float((np.abs(np.diff(program.pressure, axis=0)).max(axis=1) / np.diff(program.time)).max())


def _rows(times: Any, pressures: Any, seconds: float) -> PressureProgram:
    return PressureProgram(np.asarray(times, dtype=float), np.atleast_2d(np.asarray(pressures, dtype=float)), seconds)


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
    tried = programs(design, rig)
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
            left = apart - slopes @ np.linalg.solve(ridge, slopes.T @ apart)
            least = min(least, float(np.sqrt(3 * np.mean(left**2))))
    return least
