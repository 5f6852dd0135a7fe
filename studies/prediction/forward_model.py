"""A simulator and a model become the one forward model that every study asks; motions and shapes at rest with the
muscles on them: their axes, contractions and tensions; and whether a model's motions need the fine grid that it was
calibrated on, decided for each design."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.acting import seen_at
from fabdesign.effects.registry import effect_named
from fabdesign.files.motion_file import Motion, square_triangles
from fabdesign.geometry.shape import LacedMuscles, laced_muscles
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import POINTS_PER_SIDE, Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.nouns.trial import Trial
from fabdesign.units import in_mm
from studies.prediction.stability import rms


def sensed_model(simulator: ForwardModel, model: Model | None) -> Predictor:
    """Return `forward_model` with what the sensors add to what is measured."""
    return replace(forward_model(simulator, model), sensing=True)


def forward_model(simulator: ForwardModel, model: Model | None) -> Predictor:
    """Return `simulator` with all of `model`: factors, effects, corrector.

    Raises InputError for a model with a part that cannot be used.
    """
    model = model or Model()
    if model.corrector is None:
        return Predictor(simulator, model)
    from corrector.field import load_corrector  # a few milliseconds that only a model with one costs

    return Predictor(simulator, model, corrector=load_corrector(model))


def without_resistance(predictor: Predictor) -> Predictor | None:
    """Return what derivatives of shapes at rest are cheap of and near the model's, where it has forces against motion,
    for which the simulator has no tangent; None where it has none."""
    kept = unresisted(predictor.model)
    return None if kept == predictor.model else replace(predictor, model=kept)


def unresisted(model: Model) -> Model:
    """Return the model less its forces against motion."""
    return replace(
        model, effects=tuple(term for term in model.effects if not effect_named(term.name, "effects").resists)
    )


def not_corrected(model: Model, designs: Iterable[Design]) -> list[str]:
    """Return a line on each design that the model's corrector declines, and why: its motions are the simulator's."""
    if model.corrector is None:
        return []
    from corrector.field import load_corrector

    corrector, lines = load_corrector(model), []
    for name, design in {design.name: design for design in designs}.items():
        trust = corrector.trust(design)
        if not trust.applies:
            lines.append(
                f"{name}: not corrected: {trust.distance:.2f} from the designs that the corrector learned from, more "
                f"than its limit of {trust.limit:.2f}; its motions are the simulator's"
            )
    return lines


def extrapolated(model: Model | None, programs: Sequence[PressureProgram]) -> list[str]:
    """Return a line where the pressures go beyond those that the model's coefficients without a physical name were
    fitted to; none for a model without such coefficients, or whose file does not say what they were fitted to."""
    if model is None or model.learned_range is None:
        return []
    if all(effect_named(term.name, "effects").named for term in model.effects):
        return []
    line = model.learned_range.beyond(programs)
    return [] if line is None else [line]


def knows_muscles(forward: ForwardModel) -> bool:
    """Return whether it gives more than shapes, as `sim.Simulator` does."""
    return hasattr(forward, "run") and hasattr(forward, "rest")


class WithMuscleStates:
    """A nouns.forward.ForwardModel; `last`: the motions of the last call, each a `SimulatedMotion` with time (T,)
    s, contraction and tension (T, intervals) N. `simulator`: one that `knows_muscles`."""

    def __init__(self, simulator: ForwardModel) -> None:
        self._simulator: Any = simulator
        self.last: list[Any] = []

    def motions(self, cases: Sequence[Case], times: Sequence[Array]) -> list[NDArray[np.float32]]:
        self.last = self._simulator.run(cases, times)
        return [motion.points for motion in self.last]

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        self.last = self._simulator.rest(cases)
        return [shape.points[0] for shape in self.last]


def laced_motions(predictor: Predictor, cases: Sequence[Case], times: Sequence[Array] | None) -> list[Motion]:
    """Return the motions of a predictor, or without times its shapes at rest, as motions of one frame at the end of the
    pressures; contraction and tension where its simulator knows them. A motion that diverged holds NaN."""
    kept = WithMuscleStates(predictor.simulator) if knows_muscles(predictor.simulator) else None
    predictor = predictor if kept is None else replace(predictor, simulator=kept)
    if times is None:
        motions = [shape[None] for shape in predictor.equilibria(cases)]
        times, seen = [np.array([case.program.duration]) for case in cases], [np.zeros(1)] * len(cases)
    else:
        motions, seen = predictor.motions(cases, times), [*times]
        if predictor.sensing:
            seen = [seen_at(predictor.case(case), at) for case, at in zip(cases, times, strict=True)]
    states = kept.last if kept else [None] * len(cases)
    return [_motion(*one) for one in zip(cases, times, motions, states, seen, strict=True)]


def _motion(case: Case, at: Array, points: NDArray[np.float32], state: Any, seen: Array) -> Motion:
    """Return the motion with its muscles. state: the simulator's own motion, whose instants hold those that are `seen`
    (T,) s, and perhaps more."""
    fabric, states = case.design.fabric, {}
    if state is not None:
        frames = np.abs(state.time[:, None] - seen).argmin(axis=0)
        states = {"contraction": state.contraction[frames], "tension": state.tension[frames]}
    muscles: LacedMuscles = laced_muscles(case.design, points, **states)
    return Motion(at, points, square_triangles(points.shape[1]), (fabric.width, fabric.height), muscles)


GRID_ERROR = 1e-4  # m RMS over the points and frames of a motion, under which the coarser grid is as good
_FEWEST = 6  # trials of a design, for it to be tried: below, trying costs more than it spares


@dataclass(frozen=True)
class ByDesign:
    """A simulator for each design: `coarse` where it is as good, else `fine`. Implements
    fabdesign.nouns.forward.ForwardModel."""

    fine: ForwardModel
    coarse: ForwardModel
    calm: tuple[Design, ...]  # for which the coarse one is as good

    def motions(self, cases: Sequence[Case], times: Sequence[Array]) -> list[NDArray[np.float32]]:
        """Return what the simulator of each case's design gives."""
        return self._asked(
            cases, lambda of, numbers: of.motions([cases[i] for i in numbers], [times[i] for i in numbers])
        )

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        """Return what the simulator of each case's design gives."""
        return self._asked(cases, lambda of, numbers: of.equilibria([cases[i] for i in numbers]))

    def _asked(
        self, cases: Sequence[Case], ask: Callable[[ForwardModel, list[int]], list[NDArray[np.float32]]]
    ) -> list[NDArray[np.float32]]:
        by_case: dict[int, NDArray[np.float32]] = {}
        for simulator, calm in ((self.fine, False), (self.coarse, True)):
            if numbers := [i for i, case in enumerate(cases) if (case.design in self.calm) is calm]:
                by_case |= dict(zip(numbers, ask(simulator, numbers), strict=True))
        return [by_case[i] for i in range(len(cases))]


def enough_points(
    model: Model,
    trials: Sequence[Trial],
    forward: Callable[[int], ForwardModel],
    *,
    tell: Callable[[str], None] = lambda line: None,
) -> ForwardModel:
    """Return the simulator for `trials`: of the model's grid, and for designs whose points that moves by under 0.1 mm
    RMS, of 41 points a side.

    Tried on the most strongly driven trial of each design, with the simulators `forward(points a side)`: cloth that
    snaps goes another way on another grid, and it is there that it snaps. `tell` hears a line on what was found. Raises
    InputError.
    """
    fine = forward(model.points_per_side)
    tried = _driven(trials) if model.points_per_side > POINTS_PER_SIDE else []
    if not tried:
        return fine
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in tried]
    times = [trial.times for trial in tried]
    coarse = forward(POINTS_PER_SIDE)
    # the fine one first: room is then made once
    both = [forward_model(simulator, model).motions(cases, times) for simulator in (fine, coarse)]
    apart = [float(np.nan_to_num(rms(a - b), nan=np.inf)) for a, b in zip(*both, strict=True)]  # inf: it diverged
    calm = tuple(trial.design for trial, off in zip(tried, apart, strict=True) if off < GRID_ERROR)
    for trial, off in zip(tried, apart, strict=True):
        points = POINTS_PER_SIDE if off < GRID_ERROR else model.points_per_side
        tell(
            f"grid: {points} points a side for {trial.design_name}; "
            f"with {POINTS_PER_SIDE} instead of the model's {model.points_per_side}, {trial.name} moves by "
            f"{in_mm(off):.2f} mm RMS, {'under' if off < GRID_ERROR else 'not under'} {in_mm(GRID_ERROR):g}"
        )
    return ByDesign(fine, coarse, calm) if calm else fine


def _driven(trials: Sequence[Trial]) -> list[Trial]:
    """Return for each design that many trials have the trial with the highest pressures: the mean over channels of the
    highest of each."""
    designs: list[Design] = []
    for trial in trials:
        if trial.design not in designs:
            designs.append(trial.design)
    groups = [[trial for trial in trials if trial.design == design] for design in designs]

    def drive(trial: Trial) -> float:
        return float(trial.program.pressure.max(axis=0).mean()) if trial.design.channels else 0.0

    return [max(group, key=drive) for group in groups if len(group) >= _FEWEST]
