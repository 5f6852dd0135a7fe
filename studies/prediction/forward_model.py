"""A simulator and a model become the one forward model that every study asks; motions and shapes at rest with the
muscles on them: their axes, contractions and tensions."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
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
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram


def forward_model(simulator: ForwardModel, model: Model | None, *, sensing: bool = False) -> Predictor:
    """Return `simulator` with all of `model`: factors, effects, corrector, and where asked for what its sensors add.

    Raises InputError for a model with a part that cannot be used.
    """
    model = model or Model()
    if model.corrector is None:
        return Predictor(simulator, model, sensing)
    from corrector import load_corrector  # a few milliseconds that only a model with one costs

    return Predictor(simulator, model, sensing, load_corrector(model))


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
    from corrector import load_corrector

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

    def motions(self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float32]]:
        self.last = self._simulator.run(cases, times)
        return [motion.points for motion in self.last]

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        self.last = self._simulator.rest(cases)
        return [shape.points[0] for shape in self.last]


def laced_motions(
    forward: ForwardModel, model: Model | None, cases: Sequence[Case], times: Sequence[Array], *, sensing: bool = False
) -> list[Motion]:
    """Return the motions of `forward_model(forward, model, sensing=sensing)`; contraction and tension where `forward`
    knows them. A motion that diverged holds NaN."""
    kept = WithMuscleStates(forward) if knows_muscles(forward) else None
    predictor = forward_model(kept or forward, model, sensing=sensing)
    motions = predictor.motions(cases, times)
    laced = []
    for k, (case, at, points) in enumerate(zip(cases, times, motions, strict=True)):
        seen = seen_at(predictor.case(case), at) if sensing else at
        laced.append(_motion(case, at, points, kept.last[k] if kept else None, seen))
    return laced


def laced_rests(forward: ForwardModel, model: Model | None, cases: Sequence[Case]) -> list[Motion]:
    """Return the shapes at rest, as motions of one frame at the end of the pressures."""
    kept = WithMuscleStates(forward) if knows_muscles(forward) else None
    shapes = forward_model(kept or forward, model).equilibria(cases)
    return [
        _motion(case, np.array([case.program.duration]), points[None], kept.last[k] if kept else None, np.zeros(1))
        for k, (case, points) in enumerate(zip(cases, shapes, strict=True))
    ]


def _motion(case: Case, at: Array, points: NDArray[np.float32], state: Any, seen: Array) -> Motion:
    """Return the motion with its muscles. state: the simulator's own motion, whose instants hold those that are `seen`
    (T,) s, and perhaps more."""
    fabric, states = case.design.fabric, {}
    if state is not None:
        frames = np.abs(state.time[:, None] - seen).argmin(axis=0)
        states = {"contraction": state.contraction[frames], "tension": state.tension[frames]}
    muscles: LacedMuscles = laced_muscles(case.design, points, **states)
    return Motion(at, points, square_triangles(points.shape[1]), (fabric.width, fabric.height), muscles)
