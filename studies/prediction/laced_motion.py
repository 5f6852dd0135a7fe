"""Motions and shapes at rest with the muscles on them: their axes, contractions and tensions."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.acting import seen_at
from fabdesign.files.motion_file import Motion, square_triangles
from fabdesign.geometry.laced_muscles import LacedMuscles, laced_muscles
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import Model
from studies.prediction.forward_model import forward_model


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


Array = NDArray[np.float64]


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
