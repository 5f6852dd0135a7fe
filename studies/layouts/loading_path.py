"""The loading path: the motion from rest to a result, and copies of it with changed inputs. Which shape is reached."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from fabdesign.formats.schema import Key, Millimetre
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.pressure import PressureProgram, rising_program, sequence_program
from fabdesign.units import in_mm
from optimize.search.objective import Objective, Poses, refined
from studies.prediction.stability import OFF, apart, are_one, sides

RISES = (0.2, 2.0)  # s, of copies
SETTLE = 3.0  # s after the rise: a swing is over but for a millimetre
NEARER = 0.8  # of the value: a copy that comes so much nearer shows where the target lies


@dataclass(frozen=True)
class Copy:
    """name: for people. value: m, of the searched measure; NaN where it diverged. on_another_branch: it ends at another
    stable shape than the motion does (of the motion itself: than the shape of the search)."""

    name: Annotated[str, Key("copy")]
    value: Annotated[Millimetre, Key("value_mm")]
    on_another_branch: Annotated[bool, Key("elsewhere")]


@dataclass(frozen=True, eq=False)
class LoadingPath:
    """reached: whether the motion as it should be ends at the shape that was searched for. shape: where it leads."""

    motion: Copy
    copies: tuple[Copy, ...]
    shape: Poses
    json_keys: ClassVar = (
        ("nominal_mm", "motion.value"), ("worst_mm", "worst"), "reached", ("hangs_on_it", "sensitive"), "copies",
        ("said", "sentences"),
    )  # fmt: skip

    @property
    def reached(self) -> bool:
        return not self.motion.on_another_branch

    @property
    def on_another_branch(self) -> list[Copy]:
        """Return copies that end on another branch than the motion does."""
        return [copy for copy in self.copies if copy.on_another_branch]

    @property
    def worst(self) -> float:
        """Return m, at most; infinite where one diverged."""
        values = [self.motion.value, *(copy.value for copy in self.copies)]
        return float(np.max(np.where(np.isfinite(values), values, np.inf)))

    @property
    def sensitive(self) -> bool:
        """Return whether small changes of the inputs lead to another stable shape."""
        return not self.reached or bool(self.on_another_branch)

    @property
    def sentences(self) -> list[str]:
        mm, worst = f"{in_mm(self.motion.value):.2f}", f"{in_mm(self.worst):.2f} mm"
        lines = []
        if not self.reached:
            lines.append(
                f"No simple rise of the pressures reaches the shape of the search: {self.motion.name} ends at another "
                f"stable shape, at {mm} mm. The report shows that shape."
            )
        if self.on_another_branch:
            names = ", ".join(copy.name for copy in self.on_another_branch)
            lines.append(
                f"The result is near a bifurcation: {names} end at another stable shape, at worst at {worst} instead "
                f"of {mm} mm."
            )
        nearer = [copy for copy in self.on_another_branch if copy.value < NEARER * self.motion.value]
        if nearer:
            best = min(nearer, key=lambda copy: copy.value)
            lines.append(
                f"The target lies near a stable shape that {self.motion.name} does not reach: {best.name} ends at "
                f"{in_mm(best.value):.2f} mm."
            )
        return lines or [
            f"{self.motion.name[0].upper()}{self.motion.name[1:]} ends at this shape, {mm} mm from the target. So do "
            f"all {len(self.copies)} motions with changed inputs ({', '.join(copy.name for copy in self.copies)}); the "
            f"worst is {worst} from the target."
        ]


def loading_path(
    objective: Objective,
    forward: ForwardModel,
    result: tuple[Design, Array],
    shape: Poses,
    at_rest: Poses,
    *,
    rise: float,
) -> LoadingPath:
    """Return the loading path of a result to the `shape` of the search; all motions in one batch. at_rest: its cloth
    without pressure. rise: s, of pressures that lead to a shape at rest."""
    plan = _plans(objective, *result, rise)
    programs = [program for _, of_poses in plan for program in of_poses]
    cases = [Case(result[0], program, order=objective.order) for program in programs]
    motions = forward.motions(cases, [np.array([program.duration]) for program in programs])
    ends = [refined(np.asarray(motion[-1], dtype=float)) for motion in motions]
    ended = np.array(ends).reshape(len(plan), *shape.shape)
    off_rest, goal = apart(shape, at_rest), ended[0] if np.isfinite(ended[0]).all() else shape
    motion, *copies = [
        Copy(name, objective.value(end), not are_one(apart(end, goal if k else shape), off_rest))
        for k, ((name, _), end) in enumerate(zip(plan, ended, strict=True))
    ]
    return LoadingPath(motion, tuple(copies), ended[0])


def _plans(
    objective: Objective, design: Design, pressures: Array, rise: float
) -> list[tuple[str, list[PressureProgram]]]:
    """Return the name of the motion and of each copy, and their programs, one a pose."""
    signs = sides(design)
    at_rest = any(target.time is None for target in objective.targets)
    chosen = [(f"the rise within {rise:g} s" if at_rest else "the motion", np.zeros(len(signs)), rise)]
    chosen += [
        (f"pressures {OFF:.0%} up", np.full(len(signs), OFF), rise),
        (f"pressures {OFF:.0%} down", np.full(len(signs), -OFF), rise),
        (f"front {OFF:.0%} up and back down", OFF * signs, rise),
        (f"front {OFF:.0%} down and back up", -OFF * signs, rise),
    ]
    if len(set(signs)) < 2:
        chosen = chosen[:3]
    if at_rest:
        chosen += [(f"a rise within {other:g} s", np.zeros(len(signs)), other) for other in RISES if other != rise]
    plans = [
        (
            name,
            [
                rising_program(row * (1 + off), within, within + SETTLE)
                if target.time is None
                else PressureProgram(np.zeros(1), (row * (1 + off))[None], target.time)
                for row, target in zip(pressures, objective.targets, strict=True)
            ],
        )
        for name, off, within in chosen
    ]
    if len(pressures) > 1 and all(target.time is None for target in objective.targets):
        numbers = range(1, len(pressures) + 1)
        plans.append(("the poses one after another", [sequence_program(pressures[:k], rise, SETTLE) for k in numbers]))
    return plans
