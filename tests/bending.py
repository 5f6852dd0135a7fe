"""A cloth that costs nothing: it bows by its pressures and where its muscles lie, in the place of the simulator."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fabdesign.effects.registry import effect_named
from fabdesign.nouns.forward import Case
from studies.studio.solver import Answer, Ask, StudioSolver


@dataclass(frozen=True, eq=False)
class Bent:
    """What of sim.motion.SimulatedMotion is asked for."""

    middle: np.ndarray
    points: np.ndarray


def bow(case: Case, side: int = 41) -> np.ndarray:
    """(side, side, 3) m: front muscles pull the lower edge forward, by their place across and by their pressure."""
    design = case.design
    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    z = np.zeros_like(u)
    for muscle in design.muscles:
        sign = 1 if muscle.side == "front" else -1
        middle = np.mean([p[0] for p in muscle.path]) / design.fabric.width
        z += sign * 1e-7 * case.program.pressure[-1, muscle.channel] * v**2 * np.exp(-4 * (u - middle) ** 2)
    return np.stack([(u - 0.5) * design.fabric.width, -v * design.fabric.height, z], axis=-1).astype(np.float32)


class Bending:
    """Implements what the studio's solver asks of a simulator."""

    def __init__(self, points_per_side: int = 41, **options: object) -> None:
        self.points_per_side = points_per_side

    def _bent(self, case: Case) -> Bent:
        for term in case.effects:
            effect_named(term.name, "case")  # an unknown one is refused, as the simulator does
        middle = bow(case, self.points_per_side)
        faces = [bow(case) + np.float32([0, 0, z]) for z in (1e-3, -1e-3)]
        return Bent(middle[None], np.concatenate([face.reshape(-1, 3) for face in faces])[None])

    def rest(self, cases: Sequence[Case]) -> list[Bent]:
        return [self._bent(case) for case in cases]

    def follow(self, case: Case, middle: np.ndarray) -> Bent:
        assert middle.shape == (self.points_per_side, self.points_per_side, 3)
        return self._bent(case)

    def equilibria(self, cases: Sequence[Case]) -> list[np.ndarray]:
        return [self._bent(case).points[0] for case in cases]

    def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        return [np.repeat(self._bent(c).points, len(t), axis=0) for c, t in zip(cases, times, strict=True)]


class AtOnce:
    """In the place of studies.studio.solver.SolverProcess: the answer is there when it is asked for, unless `busy`."""

    alive, busy = True, False

    def __init__(self) -> None:
        self._solver, self.asked, self._due = StudioSolver(Bending), [], []  # type: ignore[var-annotated]

    def send(self, ask: Ask) -> None:
        self.asked.append(ask)
        self._due.append(ask)

    def receive(self) -> Answer | None:
        return self._solver.answer(self._due.pop(0)) if self._due and not self.busy else None

    def close(self) -> None:
        pass


def widget(page: Any, *names: str) -> Any:
    """Of the studio's page: a widget by its name and those of what it lies in, the outermost first."""
    inside = page.widgets.made
    for name in names:
        every = [*inside, *(i for made in inside if not made.part.name for i in made.inside)]
        one = next(made for made in every if made.part.name == name)
        inside = one.inside
    return one


if __name__ == "__main__":  # the program with this cloth in the place of the simulator
    import sim
    from fabdesign.cli import main

    sim.Simulator = Bending  # type: ignore[assignment, misc]
    main()
