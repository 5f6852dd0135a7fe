"""The public way in: a batch of cases becomes motions or equilibrium shapes."""

import numbers
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

import sim.effects  # noqa: F401 declares its planes before the first batch
from fabdesign.cluster import current
from fabdesign.column import Column, move
from fabdesign.effects.acting import acting_pressure, active, specimen_of, terms_of
from fabdesign.effects.registry import EFFECTS, force_of
from fabdesign.effects.specimen import Specimen
from fabdesign.effort import COARSEST, FINEST, LONGEST, require_motion
from fabdesign.errors import InputError
from fabdesign.fabric import Fabric
from fabdesign.forward import HOLD, RISE, Case
from fabdesign.jacobian import FacesJacobian
from fabdesign.model import POINTS_PER_SIDE
from fabdesign.pressure import RISE_STEPS, rising_program
from fabdesign.sheet import Sheet
from sim.design.loading import load_batch, load_constants
from sim.design.support import Support
from sim.equilibrium import (
    FOLLOWING,
    FOLLOWING_STEP,
    FROM_FLAT,
    RESTED,
    carried_on,
    damped,
    equilibrate,
    long_steps,
)
from sim.forces.added import AddedForce
from sim.forces.contact_pairs import Touching
from sim.kernels import fields
from sim.kernels.transfer import halt, read, read_states
from sim.materials import REST_CURVATURES
from sim.motion import SimulatedMotion, motion_of
from sim.on_cluster import OnCluster
from sim.step import Solve, advance
from sim.tangent.differences import Jacobian, completed
from sim.tangent.faces import faces_changes
from sim.tangent.shapes import Solved, share_out, solve_at_rest, together
from sim.time.batch import Batch
from sim.time.packing import BLOCKS, pack
from sim.time.schedule import by_block, of_motions
from sim.time.steps import Steps, jumps_of, steps_of

Array = NDArray[np.float64]
SMOOTHING = 0.020  # m, half width over which the preconditioner's frames are averaged
TIME_STEPS = 1e-6, 1 / 240  # s
MOST_CALM, MOST_ITERATIONS = 64, 1000
TOLERANCES = 1e-12, 1e-3  # m
RISES = 0.01, 60.0  # s
_MOST_TICKS = 2000  # in which the pressures are followed to rest through what lies between regulator and muscle


@dataclass(frozen=True)
class Simulator:
    """Motions and equilibria of laced cloth, many designs at once (docs/model.md); on other machines within
    `fabdesign.cluster.on_cluster`.

    Cloth and muscles are constraints with compliances, the system of extended position-based dynamics (XPBD, Macklin et
    al. 2016), here solved to convergence: an implicit step (generalised-alpha, Chung and Hulbert 1993) by
    preconditioned conjugate gradients, so that stiffness does not depend on a number of iterations.

    Implements fabdesign.forward.ForwardModel: SI units in and out. Limits: muscles do not slip, at most 8 muscle types
    a batch. The cloth passes through itself unless `self_contact`: then nodes meet cells, without friction and without
    the thickness of muscles; borders that meet head on can pass. Steps then stay short, which costs 5 to 8 times as
    much. Raises InputError where an option is out of range.

    >>> import numpy as np
    >>> from fabdesign.catalogue import build
    >>> from fabdesign.forward import Case
    >>> from fabdesign.pressure import PressureProgram
    >>> from sim import Simulator
    >>> program = PressureProgram(np.array([0.0]), np.array([[200e3, 0.0]]), 1.0)  # Pa, from 0 s on
    >>> cases = [Case(build("cross", muscles=2), program)]
    >>> points = Simulator(points_per_side=21).motions(cases, [np.array([0.0, 0.1])])[0]  # m at 0 and 0.1 s
    >>> points.shape
    (2, 3362, 3)
    """

    points_per_side: int = POINTS_PER_SIDE
    time_step: float = 1 / 1920  # s, right after a jump of pressure; more in one as time goes on (sim/time/steps.py)
    calm_steps: int | None = None  # time steps in one, later on; 8 by default, on finer grids 4, with self_contact 1
    iterations: int = 16  # at most, in a step
    tolerance: float = 2e-7  # m, RMS over nodes of a step's last update; what it still lacks the next step makes up
    rho: float = 0.6  # spectral radius at infinity of generalised-alpha
    self_contact: bool = False  # whether layers of the cloth keep a thickness apart
    rise: float = RISE  # s, in which pressures rise on the way to an equilibrium
    hold: float = HOLD  # s, for which they then hold, where effects remember

    def __post_init__(self) -> None:
        _require("points_per_side", self.points_per_side, COARSEST, FINEST, whole=True)
        _require("time_step", self.time_step, *TIME_STEPS, unit=" s")
        if self.calm_steps is not None:
            _require("calm_steps", self.calm_steps, 1, MOST_CALM, whole=True)
        _require("iterations", self.iterations, 1, MOST_ITERATIONS, whole=True)
        _require("tolerance", self.tolerance, *TOLERANCES, unit=" m")
        _require("rho", self.rho, 0, 1)
        _require("rise", self.rise, *RISES, unit=" s")
        _require("hold", self.hold, 0, LONGEST, unit=" s")
        if not isinstance(self.self_contact, bool):
            raise InputError(f"self_contact is {self.self_contact!r}; expected True or False")

    @property
    def _calm(self) -> int:
        return self.calm_steps or (1 if self.self_contact else 8 if self.points_per_side <= 41 else 4)

    def _solve(self, batch: Batch) -> Solve:
        return Solve(self._most, self.tolerance, batch.added)

    @property
    def _most(self) -> int:
        """Iterations in a step: contacts, stiff and not in the preconditioner, take more."""
        return 2 * self.iterations if self.self_contact else self.iterations

    def motions(self, cases: Sequence[Case], times: Sequence[Array]) -> list[NDArray[np.float32]]:
        """(T, 3362, 3) points [m] of each case at its `times` [s after rest, rising]."""
        if (cluster := current()) is not None:  # whose workers make the points too
            return OnCluster(self, cluster).motions(cases, times)
        return [motion.points for motion in self.run(cases, times)]

    def sheets(self, cases: Sequence[Case], times: Sequence[Array]) -> list[Sheet]:
        """The same as mid-surfaces on this grid; faces are made where they are asked for."""
        return [Sheet(motion.middle, lambda motion=motion: motion.points) for motion in self.run(cases, times)]

    def run(self, cases: Sequence[Case], times: Sequence[Array]) -> list[SimulatedMotion]:
        """Motions with mid-surfaces, contractions and tensions; each starts from equilibrium at zero pressure, a free
        cloth flat and at rest. One that diverges, or has not come to rest where it starts, is tried once more with half
        the steps and twice the iterations, from where a damped motion comes to rest."""
        self._require_room(cases, times)
        if (cluster := current()) is not None:
            return OnCluster(self, cluster).ask("run", cases, times)
        motions = self._run(cases, times, patient=False)
        lost = [i for i, motion in enumerate(motions) if motion.diverged]
        if lost:
            again = self._finer()._run([cases[i] for i in lost], [times[i] for i in lost], patient=True)
            for i, motion in zip(lost, again, strict=True):
                motions[i] = motion
        return motions

    def _require_room(self, cases: Sequence[Case], times: Sequence[Array]) -> None:
        """Raise InputError where the motions, all together in memory, would take too much."""
        ends = [max(t[-1] if len(t) else 0.0, c.program.time[-1]) for c, t in zip(cases, times, strict=True)]
        channels = max((case.program.pressure.shape[1] for case in cases), default=0)
        require_motion(max(ends, default=0.0), sum(map(len, times)), self.points_per_side, channels=channels)

    def _finer(self) -> "Simulator":
        calm = max(1, self._calm // 2)
        return replace(
            self,
            time_step=max(self.time_step / 2, TIME_STEPS[0]),
            calm_steps=calm,
            iterations=min(2 * self.iterations, MOST_ITERATIONS),
        )

    def _run(self, cases: Sequence[Case], times: Sequence[Array], *, patient: bool) -> list[SimulatedMotion]:
        results: list[SimulatedMotion | None] = [None] * len(cases)
        wanted = [np.asarray(t, dtype=float) for t in times]
        acting = [
            acting_pressure(case, _ticks(t, self.time_step), self.time_step)
            for case, t in zip(cases, wanted, strict=True)
        ]
        jumps = [
            jumps_of(pressure.program, self.time_step, released=_is_free(case.design.fabric))
            for case, pressure in zip(cases, acting, strict=True)
        ]
        patterns = [(t[-1] if len(t) else 0.0, jump.large, jump.every) for t, jump in zip(wanted, jumps, strict=True)]
        with fields.lock:
            for chosen, packed in self._chunks(cases, patterns):
                batch, rested = self._at_rest([cases[i] for i in chosen], packed, patient=patient)
                steps = [steps_of(acting[i], wanted[i], jumps[i], calm=self._calm) for i in chosen]
                own, due = [cases[i] for i in chosen], [wanted[i] for i in chosen]
                motions = self._simulate(batch, packed, own, due, steps)
                for k, (i, motion) in enumerate(zip(chosen, motions, strict=True)):
                    results[i] = motion if rested[packed.index(k)] else replace(motion, diverged=(0.0, (0, 0)))
        return [motion for motion in results if motion is not None]

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        """(3362, 3) points [m] of each case at rest, as `rest` gives them."""
        if (cluster := current()) is not None:
            return OnCluster(self, cluster).equilibria(cases)
        return [shape.points[0] for shape in self.rest(cases)]

    def rest(self, cases: Sequence[Case]) -> list[SimulatedMotion]:
        """Shapes at rest under each program's last pressures, as motions of one frame at 0 s with its tensions. The
        last step of a damped motion moved it by less than RESTED; NaN where no such shape was found, with half the
        steps and 2 s more neither."""
        if (cluster := current()) is not None:
            return OnCluster(self, cluster).ask("rest", cases)
        shapes = self._rest(cases, patient=False)
        lost = [i for i, shape in enumerate(shapes) if shape.diverged]
        if lost:
            for i, shape in zip(lost, self._finer()._rest([cases[i] for i in lost], patient=True), strict=True):
                shapes[i] = shape
        return shapes

    def shape_jacobian(self, cases: Sequence[Case], columns: Sequence[Column], *, exact: bool = True) -> list[Jacobian]:
        """Shapes at rest and how they change with each column (docs/model.md): by the tangent of the forces where that
        is positive definite, else by differences of shapes, which each Jacobian says (`exact`). Differences too for a
        free cloth, with self_contact, where an effect adds a force, and everywhere with exact=False, for reference.
        NaN where no shape was found."""
        solvable = [i for i, case in enumerate(cases) if exact and not self.self_contact and _has_tangent(case)]
        solved = self._solve_shapes([cases[i] for i in solvable], columns) if solvable else []
        return completed(self._middles, cases, columns, dict(zip(solvable, solved, strict=True)))

    def faces_jacobian(self, cases: Sequence[Case], columns: Sequence[Column]) -> list[FacesJacobian]:
        """The same of both faces' points, as `equilibria` gives them."""
        if (cluster := current()) is not None:
            return OnCluster(self, cluster).ask("faces_jacobian", cases, columns=columns)
        jacobians = self.shape_jacobian(cases, columns)
        return [faces_changes(one, case.design.fabric.thickness) for case, one in zip(cases, jacobians, strict=True)]

    def motion_jacobian(
        self, cases: Sequence[Case], times: Sequence[Array], columns: Sequence[Column]
    ) -> list[Jacobian]:
        """Motions at their `times` and how they change with each column, by differences of motions: two a column."""

        def frames(own: Sequence[int], moved: Sequence[Case]) -> list[NDArray[np.float32]]:
            return [motion.middle for motion in self.run(moved, [times[i] for i in own])]

        return completed(frames, cases, columns, {})

    def _middles(self, _: Sequence[int], cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        """(n, n, 3) m of each shape at rest."""
        return [shape.middle[0] for shape in self.rest(cases)]

    def _solve_shapes(self, cases: Sequence[Case], columns: Sequence[Column]) -> list[Solved]:
        """Each case's shape with those columns that the tangent gave."""
        own = [
            [c for c, column in enumerate(columns) if all(map(_has_tangent, move(case, column, column.step).sides))]
            for case in cases
        ]
        lanes = share_out(cases, own)
        results: list[list[Solved]] = [[] for _ in cases]
        with fields.lock:
            for chosen, packed, batch in self._brought_to_rest([lane.case for _, lane in lanes], patient=False):
                riding = [lanes[chosen[k]][1] for k in packed]
                solved = solve_at_rest(batch, riding, columns, self._at_rest_pressure)
                for k, i in enumerate(chosen):
                    results[lanes[i][0]].append(solved[packed.index(k)])
        return [together(parts) for parts in results]

    def _brought_to_rest(self, cases: Sequence[Case], *, patient: bool) -> Iterator[tuple[list[int], list[int], Batch]]:
        """Chunk after chunk of the cases at rest in the fields: which these are, which of them rides in each lane."""
        for chosen, packed in self._chunks(cases, [()] * len(cases)):
            batch = self._load([damped(cases[i]) for i in chosen], packed)
            pressures = [self._at_rest_pressure(cases[i]) for i in chosen]
            pressure = np.zeros((max(1, *map(len, pressures)), len(packed)))
            for lane, i in enumerate(packed):
                pressure[: len(pressures[i]), lane] = pressures[i]
            equilibrate(batch, by_block(pressure), self._solve(batch), rise=self.rise, hold=self.hold, patient=patient)
            yield chosen, packed, batch

    def follow(self, case: Case, middle: NDArray[np.float32], *, steps: int = FOLLOWING) -> SimulatedMotion:
        """From a shape nearby, `middle` (n, n, 3) m, towards rest under the program's last pressures, as a motion of
        one frame: quick, and on the branch where `middle` is. Whether it has come to rest shows in how far another call
        moves it. Memory of forces stays at rest."""
        with fields.lock:
            (_, packed), *_ = self._chunks([case], [()])
            batch = self._load([damped(case)], packed)
            carried_on(batch, middle)
            pressure = np.repeat(self._at_rest_pressure(case)[:, None], len(packed), axis=1)
            long_steps(batch, by_block(pressure), self._solve(batch), ((FOLLOWING_STEP, steps),))
            shape = self._middle(batch, fields.F.x0)[:1]
            return motion_of(case, np.zeros(1), shape, self._states(batch)[:1])

    def _rest(self, cases: Sequence[Case], *, patient: bool) -> list[SimulatedMotion]:
        results: list[SimulatedMotion | None] = [None] * len(cases)
        with fields.lock:
            for chosen, packed, batch in self._brought_to_rest(cases, patient=patient):
                middle = self._middle(batch, fields.F.x0)
                middle[~self._rested(batch)] = np.nan
                states = self._states(batch)
                for k, i in enumerate(chosen):
                    lane = packed.index(k)
                    one = slice(lane, lane + 1)
                    results[i] = motion_of(cases[i], np.zeros(1), middle[one], states[one])
        return [shape for shape in results if shape is not None]

    def _at_rest_pressure(self, case: Case) -> Array:
        """(channels,) Pa that act at rest, once the program's last pressures have risen and were held."""
        last = case.program.pressure[-1]
        if not any(effect.pressure for effect, _, _ in active(case)):
            return last
        duration = self.rise + self.hold
        rising = rising_program(last, self.rise, duration)
        tick = max(self.rise / RISE_STEPS, duration / _MOST_TICKS)
        return np.asarray(acting_pressure(replace(case, program=rising), int(np.ceil(duration / tick)), tick).means[-1])

    def _chunks(self, cases: Sequence[Case], patterns: Sequence[tuple]) -> list[tuple[list[int], list[int]]]:
        """Cases that one call can take, held alike and so that a design's result does not depend on its neighbours, at
        most BLOCKS blocks; and which of these rides in each lane."""
        groups: dict[tuple[Support, bool, bool, int, bool], list[int]] = {}
        for i, case in enumerate(cases):
            specimen = specimen_of(case) if terms_of(case) else Specimen(case.design, {})
            fabric = specimen.design.fabric
            start = _is_free(fabric), _swings_to_rest(specimen)
            alike = Support.of(fabric), *start, self._smoothing(fabric), _has_added_force(case)
            groups.setdefault(alike, []).append(i)
        chunks: list[tuple[list[int], list[int]]] = []
        for group in groups.values():
            blocks = pack([patterns[i] for i in group])
            for k in range(0, len(blocks), BLOCKS):
                lanes = [i for block in blocks[k : k + BLOCKS] for i in block]
                own = list(dict.fromkeys(lanes))
                chunks.append(([group[i] for i in own], [own.index(i) for i in lanes]))
        return chunks

    def _load(self, cases: Sequence[Case], packed: Sequence[int]) -> Batch:
        n = self.points_per_side
        fabric = cases[0].design.fabric
        support, smoothing = Support.of(fabric), self._smoothing(fabric)
        points = load_batch([cases[i] for i in packed], n, support=support, blocks=BLOCKS)
        touching = Touching(cases, packed, n) if self.self_contact else None
        added = _added_forces() if _has_added_force(cases[0]) else ()
        return Batch(len(packed) // fields.LANES, n, n, points, support, smoothing, touching, added)

    def _smoothing(self, fabric: Fabric) -> int:
        """In nodes."""
        return max(1, round(SMOOTHING * (self.points_per_side - 1) / fabric.height))

    def _at_rest(
        self, cases: Sequence[Case], packed: Sequence[int], *, patient: bool
    ) -> tuple[Batch, NDArray[np.bool_]]:
        """Load the cases and bring them to equilibrium at zero pressure; a free cloth stays flat where it lies. Also
        which lanes (lanes,) came to rest. patient: by a damped motion, where the cloth leaves its plane."""
        all_of_them = np.ones(len(packed), dtype=bool)
        if _is_free(cases[0].design.fabric):
            return self._load(cases, packed), all_of_them
        channels = max(max(1, case.program.pressure.shape[1]) for case in cases)
        pressure = np.zeros((len(packed) // fields.LANES, channels, fields.LANES), np.float32)
        swings = _swings_to_rest(specimen_of(cases[0]))
        if swings and (patient or not Support.of(cases[0].design.fabric).is_edge):
            batch = self._load([damped(case) for case in cases], packed)
            equilibrate(batch, pressure, self._solve(batch), patient=True)
            load_constants([cases[i] for i in packed], self.points_per_side)
            halt(*batch.grid)
            return batch, all_of_them
        batch = self._load(cases, packed)
        long_steps(batch, pressure, self._solve(batch), FROM_FLAT)
        return batch, self._rested(batch) if swings else all_of_them

    def _simulate(
        self, batch: Batch, packed: Sequence[int], cases: Sequence[Case], times: Sequence[Array], steps: Sequence[Steps]
    ) -> list[SimulatedMotion]:
        """The motions from where the batch is."""
        n = self.points_per_side
        schedule, begins = of_motions(batch, packed, steps, tick=self.time_step, rho=self.rho)
        shapes, states = advance(batch, schedule, self._solve(batch), frames=int(begins[-1]))
        own = [slice(*span) for span in pairwise(begins)]
        return [
            motion_of(case, t, shapes[span].reshape(-1, n, n, 3), states[span])
            for case, t, span in zip(cases, times, own, strict=True)
        ]

    def _rested(self, batch: Batch) -> NDArray[np.bool_]:
        """(lanes,) whether the last step moved them by less than RESTED."""
        moved = self._middle(batch, fields.F.x0) - self._middle(batch, fields.F.xp)
        return np.asarray(np.sqrt(np.square(moved).sum(axis=-1).mean(axis=(1, 2))) < RESTED)  # NaN compares false

    def _middle(self, batch: Batch, plane: int) -> NDArray[np.float32]:
        """(lanes, n, n, 3) positions [m] in a plane of F.node3."""
        n = self.points_per_side
        out = np.empty((batch.blocks, fields.LANES, n * n, 3), np.float32)
        read(*batch.grid, plane, out)
        return out.reshape(-1, n, n, 3)

    def _states(self, batch: Batch) -> NDArray[np.float32]:
        """(lanes, points, 2): contraction and tension [N] of every interval as last evaluated."""
        out = np.zeros((batch.blocks, fields.LANES, max(batch.points, 1), 2), np.float32)
        read_states(batch.blocks, batch.points, out)
        return out[:, :, : batch.points].reshape(batch.blocks * fields.LANES, batch.points, 2)


def _require(name: str, value: Any, least: float, most: float, *, whole: bool = False, unit: str = "") -> None:
    """Raise InputError where an option is no number of that range."""
    sort = numbers.Integral if whole else numbers.Real
    number = isinstance(value, sort) and not isinstance(value, bool)
    if not number or not least <= float(value) <= most:
        kind = " whole" if whole else ""
        raise InputError(f"{name} is {value!r}; expected a{kind} number from {least:g} to {most:g}{unit}")


def _ticks(times: Array, tick: float) -> int:
    """Ticks until the last of `times` [s]."""
    return max(1, int(np.ceil(times[-1] / tick - 1e-6))) if len(times) else 1


def _has_added_force(case: Case) -> bool:
    return any(effect.force is not None for effect, _, _ in active(case))


def _has_tangent(case: Case) -> bool:
    """Whether its shape at rest is where forces of positions alone balance."""
    return not _is_free(case.design.fabric) and not _has_added_force(case)


def _added_forces() -> tuple[AddedForce, ...]:
    """Those of all effects: one kernel serves them all, and values make them zero."""
    return tuple(dict.fromkeys(force_of(effect) for effect in EFFECTS.values() if effect.force is not None))


def _is_free(fabric: Fabric) -> bool:
    """Whether nothing holds the cloth: what it would come to rest at is not there."""
    return Support.of(fabric) == Support.NONE


def _swings_to_rest(specimen: Specimen) -> bool:
    """Whether the cloth without pressure leaves the plane of the flat cloth, or turns in it."""
    fabric = specimen.design.fabric
    curved = any(specimen.constants.get(name) for name in REST_CURVATURES)
    return curved or fabric.gravity[2] != 0 or (Support.of(fabric) == Support.POINTS and any(fabric.gravity))
