"""Training data from measured sets: trials chosen, a base fitted to them, its motions, each once."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError, SimulationError
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Case, ForwardModel, with_history
from fabdesign.nouns.model import Model
from fabdesign.nouns.trial import MeasurementSet, Trial
from fabdesign.runtime.effort import batches
from fabdesign.runtime.store import Arrays, Checkpoint
from optimize.fit.clouds import evenly
from optimize.fit.parameters import FitVector
from studies.calibration import CalibrationOptions, calibrate_sets
from studies.measured.splits import split
from studies.measured.used_frames import UsedFrames, find_used_frames

Network = Literal["field", "paper"]
KEPT_BACK = 0.15  # share of the trials that are not learned from and say what the corrector is worth
_AT_ONCE = 32  # motions in memory
FRAMES = 8  # of a trial that are learned from, spread over it: neighbours say the same

Progress = Callable[[str, int, int], None]  # what is done, how many of how many


@dataclass(frozen=True)
class TrainingOptions:
    """The options of a training. base: whose parameters and effects the motions have. vector: fit these unknowns to the
    trials that are learned from first, and take that model for the base; slopes: the fit's cheaper engine. plan: of the
    network; by default its own. hold_out: designs, and kept_back: the share of the other trials, that are not learned
    from. coarse: a cheap simulator that finds sensitive stretches, which are left out, and asks drawn models for the
    intervals, which are calibrated on the trials kept back."""

    base: Model = field(default_factory=Model)
    vector: FitVector | None = None
    slopes: ForwardModel | None = None
    network: Network = "field"
    plan: Any = None
    hold_out: Collection[str] = ()
    kept_back: float = KEPT_BACK
    seed: int = 0
    coarse: ForwardModel | None = None


@dataclass(frozen=True, eq=False)
class Chosen:
    """A trial that takes part."""

    name: str  # SET/TRIAL
    key: str  # of what is kept of it
    trial: Trial
    case: Case  # with the base model's factors and effects
    used: NDArray[np.bool_]  # (T,) mask of its frames; sensitive ones are left out


class TrialSplit(NamedTuple):
    """Trials to learn from and trials held out, and which of their frames are used."""

    learned: list[Chosen]
    held_out: list[Chosen]
    used: UsedFrames


def choose(sets: Sequence[MeasurementSet], options: TrainingOptions) -> TrialSplit:
    """Return trials to learn from and trials held out, of role `fit`: all of the designs `hold_out`, and about the
    share `kept_back` of the others, whole trials, those with the same pressures on one side; and which of their frames
    are used. A trial without a frame that is used is in neither.

    Raises InputError for a design that no set has, and where nothing or too little is left.
    """
    known = sorted({trial.design_name for measured in sets for trial in measured.trials})
    for name in options.hold_out:
        if name not in known:
            raise InputError(f"--hold-out {name}: no such design; the sets have {', '.join(known)}")
    learned: list[Chosen] = []
    held: list[Chosen] = []
    fitting = [[trial for trial in measured.trials if trial.role == "fit"] for measured in sets]
    used = find_used_frames([*zip(sets, fitting, strict=True)], options.coarse)
    for k, (measured, every) in enumerate(zip(sets, fitting, strict=True)):
        flags = {trial.name: used.at(measured, trial) for trial in every}
        fit = [trial for trial in every if flags[trial.name].any()]
        rest = [trial for trial in fit if trial.design_name not in options.hold_out]
        sides = (rest, [t for t in fit if t.design_name in options.hold_out])
        if rest and options.kept_back > 0:
            parts = split(rest, options.kept_back, seed=options.seed)
            sides = (list(parts.fit), [*parts.held_out, *sides[1]])
        for side, trials in zip((learned, held), sides, strict=True):
            side += [
                Chosen(f"{measured.name}/{t.name}", f"{k:02}-{t.name}", t, case_of(t, options.base), flags[t.name])
                for t in trials
            ]
    if not learned:
        raise InputError("no trial of role fit is left to learn from; expected at least two")
    return TrialSplit(learned, held, used)


def case_of(trial: Trial, base: Model) -> Case:
    """Return the trial's motion as the base model has it."""
    return Case(trial.design, trial.program, base.factors, base.terms, trial.order)


def check_one_cloth(trials: Sequence[Chosen]) -> None:
    """Raise InputError where the trials' cloths differ."""
    first = trials[0].trial.design
    for design in (chosen.trial.design for chosen in trials):
        for what in ("width", "height", "hung", "support", "gravity", "areal_density", "bending_stiffness"):
            values = getattr(first.fabric, what), getattr(design.fabric, what)
            if values[0] != values[1]:
                raise InputError(
                    f"{design.name}: {what} = {values[1]}, {first.name} has {values[0]}; expected one cloth, hung alike"
                )


def frames_learned(chosen: Chosen) -> NDArray[np.intp]:
    """Return indices of the frames that are learned from, of those used."""
    usable = np.flatnonzero(chosen.used)
    return np.asarray(usable[evenly(len(usable), FRAMES)])


def fitted_base(
    sets: Sequence[MeasurementSet],
    learned: Sequence[Chosen],
    options: TrainingOptions,
    forward: ForwardModel,
    checkpoint: Checkpoint,
    *,
    progress: Progress,
) -> Model:
    """Return the model that a corrector stands on; where unknowns are fitted, as `calibrate` does, but to none of the
    trials that are held out."""
    if options.vector is None:
        return options.base
    taking_part = {chosen.trial.file for chosen in learned}
    learning = [replace(one, trials=tuple(t for t in one.trials if t.file in taking_part)) for one in sets]
    return calibrate_sets(
        [one for one in learning if one.trials],
        forward,
        vector=options.vector,
        checkpoint=checkpoint,
        progress=lambda line, share: progress(f"base: {line}", round(100 * share), 100),
        options=CalibrationOptions(
            slopes=options.slopes, points_per_side=options.base.points_per_side, seed=options.seed
        ),
    ).model


@dataclass(frozen=True, eq=False)
class KeptMotions:
    """Motions of trials at `with_history(times(trial), history)`, each simulated once and kept in a training's folder.
    Raises SimulationError where one diverges."""

    forward: ForwardModel
    checkpoint: Checkpoint
    progress: Progress
    times: Callable[[Chosen], Array] = attrgetter("trial.times")
    history: tuple[float, ...] = ()

    def simulate(self, trials: Sequence[Chosen]) -> None:
        """Keep those that are not kept yet, many at once."""
        missing = [chosen for chosen in trials if not self.checkpoint.has(self._name(chosen))]
        done = len(trials) - len(missing)
        for part in batches([2 * len(self.times(chosen)) for chosen in missing], _AT_ONCE):
            batch = missing[part]
            for chosen, motion in zip(batch, self._simulated(batch), strict=True):
                self._kept(chosen, motion)
            done += len(batch)
            self.progress("simulated", done, len(trials))

    def of(self, trials: Sequence[Chosen]) -> list[NDArray[np.float32]]:
        """Return (U, 2 n, 3) m of each."""
        self.simulate(trials)
        return [self._kept(chosen) for chosen in trials]

    def _kept(self, chosen: Chosen, motion: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return what is kept of a trial; else keep its motion first, simulated where it is not given."""

        def arrays() -> Arrays:
            return {"points": self._simulated([chosen])[0] if motion is None else motion}

        return self.checkpoint.arrays(self._name(chosen), arrays)["points"]

    def _name(self, chosen: Chosen) -> str:
        return f"motion_{chosen.key}-{len(self.times(chosen))}-{len(self.history)}"

    def _simulated(self, some: Sequence[Chosen]) -> list[NDArray[np.float32]]:
        wanted = [with_history(self.times(chosen), self.history)[0] for chosen in some]
        simulated = self.forward.motions([chosen.case for chosen in some], wanted)
        for chosen, motion in zip(some, simulated, strict=True):
            if not np.isfinite(motion).all():
                raise SimulationError(f"{chosen.name}: the motion diverged; nothing written")
        return simulated
