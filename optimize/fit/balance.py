"""Frames of motions in balance: near which unknowns the fit of motions begins, without horizons and false minima.

A frame of a motion is in balance, with its inertia and damping (d'Alembert). Of the displacement from the model's
motion to the measured cloth, velocity and acceleration are seen in the frames around it; the rest is what the unknowns
change in the forces, by their tangent (`sim.tangent.motion`): equation error in system identification, the virtual
fields method in mechanics. From the second step on the cloth seen leads the motion by known forces (`nouns.lead`), so
that it buckles to the same side, and the displacement is small. What noise does to accelerations is no residual of the
model, so intervals and verdicts come from motions alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from dataclasses import fields as dataclass_fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.acting import is_sensing, observed, seen_at, terms_of
from fabdesign.effects.registry import EFFECTS, label_effect
from fabdesign.files.trial_file import TrialData
from fabdesign.geometry.shape import normals
from fabdesign.nouns.array import Array, Floats, Indices
from fabdesign.nouns.column import SPRINGS, Column, Course, Move, move
from fabdesign.nouns.forward import Case, Instant
from fabdesign.nouns.lead import Balancer, Lead, Way
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import Trial
from fabdesign.runtime.store import Arrays, Checkpoint
from fabdesign.units import in_mm
from optimize.fit.clouds import Match, Sample, derivatives, drawn, evenly, match, nodes_of
from optimize.fit.descent import Progress, silent
from optimize.fit.displacement import Unstrained, heights, rms_of, savitzky_golay
from optimize.fit.fitted import Ending, Fit, concluded
from optimize.fit.misfit import frames_of
from optimize.fit.normal import step_to_minimum
from optimize.fit.parameters import FitVector
from optimize.fit.policy import UNSURE
from optimize.fit.problem import Linearisation, Problem, fingerprint

FRAMES = 10  # of a trial, that balance
POINTS = 400  # of a frame
HALF = 2  # frames to each side, through which velocity and acceleration are seen
WIDEST = 0.28  # s that these may span, as at 15 Hz: beyond, a swing of 8 rad/s turns by more than a third
FIRST = 0.1  # s after rest, before which little has moved
COURSE, MOST = 1 / 80, 1000  # s between the instants that muscles remember a motion by, and how many at most
INSTANTS = np.arange(-2, 3) / 160  # s, from a frame, of the motion's own velocity and acceleration
RADIUS = 0.05  # m, of a cloth's bends: a displacement d is off by d^2 over it where it is taken as linear
STEP = 0.007  # of a prior's deviation, of a column
ITERATIONS, FAR_OFF = 12, 3  # at most; and those at first, where frames far off promise little


Leads = Sequence[Lead | None]  # a trial


@dataclass(frozen=True, eq=False)
class FramesAround:
    """Frames of a trial, and each with those around it. around: (F, 2 HALF + 1) places in the sample."""

    sample: Sample
    around: Indices

    @property
    def central(self) -> Sample:
        """Return the frames without those around them."""
        every, chosen = self.sample, self.around[:, HALF]
        return Sample(every.trial, every.times[chosen], tuple(every.clouds[k] for k in chosen))


def frames_around(
    trial: Trial, data: TrialData, used: NDArray[np.bool_], rng: np.random.Generator
) -> FramesAround | None:
    """Return frames spread over those of a trial that are `used` (T,), as are all around them; None where frames are
    too far apart for an acceleration to be seen."""
    offsets, time = np.arange(-HALF, HALF + 1), data.time
    inside = [
        k
        for k in range(HALF, len(time) - HALF)
        if used[k + offsets].all() and time[k + HALF] - time[k - HALF] <= WIDEST and time[k] >= FIRST
    ]
    if not inside:
        return None
    around = np.array(inside)[evenly(len(inside), FRAMES)][:, None] + offsets
    every = np.unique(around)
    return FramesAround(drawn(trial, data, every, POINTS, rng), np.searchsorted(every, around))


@dataclass(frozen=True, eq=False)
class BalanceProblem(Problem):
    """Frames of motions in balance. forward: the model, of which `engine` is the simulator. noise: m, of a point."""

    frames: Sequence[FramesAround]
    forward: Predictor
    engine: Balancer
    vector: FitVector
    noise: float

    @property
    def samples(self) -> Sequence[Sample]:  # type: ignore[override]
        return [one.central for one in self.frames]

    def at(self, x: Array, leads: Leads) -> tuple[Linearisation, Leads]:
        """Return the residuals and their Jacobian at the unknowns x (p,), each frame by how well it is known; and the
        cloths seen, as `leads` of motions at other unknowns, which then stay beside them."""
        motions = self._motions([self.vector.case(one.sample.trial, x) for one in self.frames], leads)
        every = match([motion.frames.sample for motion in motions], [motion.points for motion in motions])
        rows = iter(frames_of(every)[1])
        side, sensed = motions[0].middle.shape[1], [self._columns[k] for k in self._sensed]
        off = [heights(every, [next(rows) for _ in motion.middle], side) for motion in motions]
        held = [motion.held(some, sensed) for motion, some in zip(motions, off, strict=True)]
        central = _central(every, self.frames)
        slopes = derivatives(central, nodes_of(central, side), self._changes(motions, [some for some, _ in held]))
        doubt = np.concatenate([uncertain for _, uncertain in held])
        counts = self.noise / np.hypot(self.noise, doubt[frames_of(central)[0]])
        residual = (central.residual + slopes[:, 0]) * counts
        there = Linearisation(x, replace(central, residual=residual), (), slopes[:, 1:] * counts[:, None])
        return there, [motion.seen_cloth(some) for motion, some in zip(motions, off, strict=True)]

    def _motions(self, cases: Sequence[Case], leads: Leads) -> list["_Motion"]:
        """Return the model's motions at all frames, and at the instants around those in balance."""
        cases = [self.forward.case(case) for case in cases]
        seen = [seen_at(case, one.sample.times) for case, one in zip(cases, self.frames, strict=True)]
        fine = [at[one.around[:, HALF], None] + INSTANTS for at, one in zip(seen, self.frames, strict=True)]
        ways = [_course(case, float(some.max())) for case, some in zip(cases, fine, strict=True)]
        times = [np.unique(np.concatenate([at, *some, way])) for at, some, way in zip(seen, fine, ways, strict=True)]
        sheets = self.engine.led(cases, [Way(*way) for way in zip(times, leads, strict=True)])
        motions = []
        made = zip(cases, self.frames, sheets, times, seen, fine, leads, strict=True)
        for case, one, sheet, every, at, some, lead in made:
            middle, frames = np.asarray(sheet.middle, dtype=float), np.searchsorted(every, at)
            points, around = observed(case, sheet.points[frames]), middle[np.searchsorted(every, some)]
            motions.append(_Motion(case, one, at, middle[frames], points, around, (every, sheet.middle), lead))
        return motions

    @cached_property
    def _columns(self) -> list[Column]:
        return [self.vector.column(k, STEP) for k in range(len(self.vector.parameters))]

    @cached_property
    def _sensed(self) -> Indices:
        """Return the unknowns of what sensors do."""
        return self.vector.parts(label for label in self.vector.labels if is_sensing(label_effect(label)))

    def _changes(self, motions: Sequence["_Motion"], held: Sequence[Sequence[Instant]]) -> list[Floats]:
        """Return the response and the changes by each unknown, (1 + p, F, n, n, 3) m a motion. held: its frames."""
        acting = np.setdiff1d(np.arange(len(self._columns)), self._sensed)
        courses = [Course(*motion.course, some) for motion, some in zip(motions, held, strict=True)]
        balances = self.engine.balances(
            [motion.case for motion in motions], courses, [self._columns[k] for k in acting.tolist()]
        )
        changes = []
        for some, balanced in zip(held, balances, strict=True):
            of_motion = np.zeros((1 + len(self._columns), len(some), *some[0].middle.shape))
            for f, (one, balance) in enumerate(zip(some, balanced, strict=True)):
                of_motion[0, f] = balance.responses[0]
                of_motion[1 + acting, f] = balance.changes
                # what is seen elsewhere need not be elsewhere: its own balance is no part of what is seen
                of_motion[1 + self._sensed, f] = one.moved[1:] - balance.responses[1:]
            changes.append(of_motion)
        return changes


@dataclass(frozen=True, eq=False)
class _Motion:
    """A motion of the model beside a trial's frames. case: with the model. seen: (m,) s, the instants of the frames.
    middle: (m, n, n, 3) m there; points: (m, 2 k, 3) m of both faces, as sensors give them. around: (F, 5, n, n, 3) m,
    at INSTANTS from each frame in balance. course: (T,) s and (T, n, n, 3) m, all of it. lead: what led it."""

    case: Case
    frames: FramesAround
    seen: Array
    middle: Array
    points: Floats
    around: Array
    course: tuple[Array, Floats]
    lead: Lead | None

    def seen_cloth(self, heights: Array) -> Lead | None:
        """Return the cloth seen, as it leads a motion; None without two frames of it."""
        middle = self.middle + heights[..., None] * normals(self.middle)
        good = np.isfinite(middle).all(axis=(1, 2, 3))
        return Lead(self.seen[good], middle[good]) if good.sum() > 1 else None

    def held(self, heights: Array, sensed: Sequence[Column]) -> tuple[list[Instant], Array]:
        """Return the frames in balance, with the displacements to the cloth seen and by a unit of each column of
        sensing, and (F,) m that each may be off by, for what is not known of its acceleration, and for what is not
        linear. heights: (m, n, n) m, of the cloth that was seen over the mid-surface."""
        held, uncertain = [], []
        moves = [move(self.case, column, column.step) for column in sensed]
        for fine, places in zip(self.around, self.frames.around, strict=True):
            middle, time = fine[len(INSTANTS) // 2], self.seen[places]
            off, offsets = heights[places][..., None] * normals(self.middle[places]), time - time[HALF]
            moved = [off[HALF], *savitzky_golay(offsets, off, 3)]
            _, unsmoothed = savitzky_golay(offsets[HALF - 1 : HALF + 2], off[HALF - 1 : HALF + 2], 2)
            doubt = np.hypot(rms_of(moved[2] - unsmoothed) / SPRINGS, rms_of(moved[0]) ** 2 / RADIUS)
            fields = middle, *savitzky_golay(INSTANTS, fine, 3)
            if np.isfinite(doubt) and np.isfinite(fields).all():
                moved = [*map(Unstrained(middle), moved)]
            elsewhere = [self._as_seen(change, fine, self.frames.sample.times[places[HALF]]) for change in moves]
            every = [moved, *([one[len(INSTANTS) // 2], *savitzky_golay(INSTANTS, one, 3)] for one in elsewhere)]
            pull = 0.0 if self.lead is None else self.lead.pull(time[HALF], *fields[:2], normals(middle[None])[0])
            instant = Instant(time[HALF], *fields, *map(np.array, zip(*every, strict=True)))
            held.append(replace(instant, pull=pull))
            uncertain.append(doubt)
        return held, np.array(uncertain)

    def _as_seen(self, change: Move, fine: Array, time: float) -> Array:
        """Return (5, n, n, 3) m per unit: what a move along a column of sensing changes of the motion at INSTANTS from
        a frame, of `time` [s] by its own clock."""
        now, *later = (float(seen_at(case, np.array([time]))[0]) for case in (self.case, *change.sides))
        velocity = np.gradient(fine, INSTANTS, axis=0)
        low, high = (observed(side, fine + (at - now) * velocity) for side, at in zip(change.sides, later, strict=True))
        return np.asarray((high - low) / change.width)


def _course(case: Case, until: float) -> Array:
    """Return the instants [s] of a motion that muscles remember it by; none where no effect does."""
    remembers = any(EFFECTS[term.name].pulls_by_record for term in terms_of(case))
    return np.linspace(0.0, until, min(round(until / COURSE), MOST)) if remembers else np.zeros(0)


def _central(every: Match, frames: Sequence[FramesAround]) -> Match:
    """Return the match of the frames in balance alone, numbered among themselves."""
    number = np.full((len(frames), 1 + int(every.frame.max())), -1)
    for s, one in enumerate(frames):
        number[s, one.around[:, HALF]] = np.arange(len(one.around))
    frame = number[every.sample, every.frame]
    kept = frame >= 0
    fields = {field.name: getattr(every, field.name)[kept] for field in dataclass_fields(Match) if field.name != "loss"}
    return Match(**(fields | {"frame": frame[kept]}))


def fit_balance(
    problem: BalanceProblem, *, named: str = "", checkpoint: Checkpoint | None = None, progress: Progress = silent
) -> Fit | None:
    """Return where Gauss-Newton steps lead from the vector's start; None where no frame has a balance. No step is
    judged: the residuals of another place are of another motion, where other frames count. checkpoint: keeps where they
    led, by the name."""
    fresh: list[_Reached | None] = []

    def arrays() -> Arrays:
        fresh.append(there := _descended(problem, progress))
        return {} if there is None else there.arrays

    name = f"fit_{named} {fingerprint(problem.vector, problem.samples)}"
    kept = arrays() if checkpoint is None else checkpoint.arrays(name, arrays)
    reached = fresh[0] if fresh else _Reached.of(kept, problem) if kept else None
    if reached is None:
        return None
    ended: Ending = "converged" if reached.iterations < ITERATIONS else "iterations"
    fit = concluded(problem, reached.state, None, reached.state.misfit.rms, reached.iterations, ended)
    return replace(fit, x=fit.minimum)


@dataclass(frozen=True, eq=False)
class _Reached:
    """Where the steps have led: the last place, and what led the motions there."""

    state: Linearisation
    leads: Leads
    iterations: int

    @property
    def arrays(self) -> Arrays:
        arrays = {"x": self.state.x, "iterations": np.array(self.iterations)}
        for i, lead in enumerate(self.leads):
            arrays |= {} if lead is None else {f"time_{i}": lead.time, f"middle_{i}": lead.middle}
        return arrays

    @staticmethod
    def of(kept: Arrays, problem: BalanceProblem) -> "_Reached":
        times = [kept.get(f"time_{i}") for i in range(len(problem.frames))]
        leads = [None if time is None else Lead(time, kept[f"middle_{i}"]) for i, time in enumerate(times)]
        return _Reached(problem.at(kept["x"], leads)[0], leads, int(kept["iterations"]))


def _descended(problem: BalanceProblem, progress: Progress) -> _Reached | None:
    x, vector = problem.vector.start, problem.vector
    leads: Leads = [None] * len(problem.frames)
    reached: _Reached | None = None
    for k in range(1, ITERATIONS + 1):
        state, seen = problem.at(x, leads)
        if not (np.isfinite(state.misfit.residual) & np.isfinite(state.jacobian).all(axis=1)).any():
            break
        reached = _Reached(state, leads, k)
        step, _ = step_to_minimum(state, vector)
        progress(f"iteration {k}: {in_mm(state.misfit.rms):.3f} mm RMS", k / (k + 2))
        x, leads = vector.inside(x + step), seen
        little = state.after(step).misfit.rms > (1 - UNSURE.least_share) * state.misfit.rms
        if float(np.abs(step / vector.scale).max()) < UNSURE.slight or (k > FAR_OFF and little):
            break
    return reached


def acting_in_balance(vector: FitVector) -> FitVector:
    """Return the factors, and the terms that have a tangent: those without a force of their own, those whose force
    a muscle's bench knows, and those that are learned, which have more than a force."""
    effects = [EFFECTS[term.name] for term in vector.terms]
    acting = [effect.force is None or effect.pulls_by_record or not effect.named for effect in effects]
    return vector.only([label for label, acts in zip(vector.labels, acting, strict=True) if acts])[0]
