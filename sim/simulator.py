"""The public way in: a batch of cases becomes motions or equilibrium shapes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

import sim.effects  # noqa: F401 declares its planes before the first batch
from fabdesign.effects.acting import acting_pressure, specimen_of
from fabdesign.effects.declaration import ActingPressure
from fabdesign.nouns.array import Array
from fabdesign.nouns.column import Balance, Column, Course, FacesJacobian, move
from fabdesign.nouns.forward import Case
from fabdesign.nouns.lead import Way
from fabdesign.runtime.cluster import current
from fabdesign.runtime.effort import require_motion
from sim import equilibrium
from sim.chunks import Chunk, chunks_of, every_force, has_added_force, laid
from sim.equilibrium import Approach
from sim.forces.lead import leading
from sim.kernels.fields import F, lock
from sim.kernels.transfer import put
from sim.loading import constants_of
from sim.motion import SimulatedMotion, motion_of
from sim.on_cluster import OnCluster
from sim.schedule import Batch, by_block, of_motions
from sim.settings import Settings
from sim.step import Solve, advance
from sim.tangent.explicit import LaneColumns, MovedCases
from sim.tangent.motion import balance_of, pressures_until, solve_in_motion
from sim.tangent.shapes import Jacobian, Share, Solved, completed, faces_changes, share_out, solve_at_rest, together
from sim.time_steps import LED, Jumps, Steps, jumps_of, steps_of, ticks_until

Solves = Callable[[Chunk, list[Share]], list[Solved]]


@dataclass(frozen=True)
class Simulator(Settings):
    """Motions and equilibria of laced cloth, many designs at once (docs/model.md); on other machines within
    `fabdesign.runtime.cluster.on_cluster`.

    Cloth and muscles are constraints with compliances, the system of extended position-based dynamics (XPBD, Macklin et
    al. 2016), here solved to convergence: an implicit step (generalised-alpha, Chung and Hulbert 1993) by
    preconditioned conjugate gradients, so that stiffness does not depend on a number of iterations.

    Implements nouns.forward.ForwardModel: SI units in and out. Limits: muscles do not slip, at most 8 muscle types
    a batch. The cloth passes through itself unless `self_contact`: then nodes meet cells, without friction and without
    the thickness of muscles; borders that meet head on can pass. Steps then stay short, which costs 5 to 8 times as
    much. Raises InputError where an option is out of range.

    >>> import numpy as np
    >>> from fabdesign.nouns.catalogue import build
    >>> from fabdesign.nouns.forward import Case
    >>> from fabdesign.nouns.pressure import PressureProgram
    >>> from sim import Simulator
    >>> program = PressureProgram(np.array([0.0]), np.array([[200e3, 0.0]]), 1.0)  # Pa, from 0 s on
    >>> cases = [Case(build("cross", muscles=2), program)]
    >>> points = Simulator(points_per_side=21).motions(cases, [np.array([0.0, 0.1])])[0]  # m at 0 and 0.1 s
    >>> points.shape
    (2, 3362, 3)
    """

    def solve(self, batch: Batch) -> Solve:
        more = 2 if self.self_contact else 1  # contacts, stiff and not in the preconditioner, take more iterations
        return Solve(more * self.iterations, self.tolerance, batch.added)

    def motions(self, cases: Sequence[Case], times: Sequence[Array]) -> list[NDArray[np.float32]]:
        """Return (T, 3362, 3) points [m] of each case at its `times` [s after rest, rising]."""
        if (cluster := current()) is not None:  # whose workers make the points too
            return OnCluster(self, cluster).motions(cases, times)
        return [motion.points for motion in self.run(cases, times)]

    def run(self, cases: Sequence[Case], times: Sequence[Array]) -> list[SimulatedMotion]:
        """Return motions with mid-surfaces, contractions and tensions; each starts from equilibrium at zero pressure, a
        free cloth flat and at rest. One that diverges, or has not come to rest where it starts, is tried once more with
        half the steps and twice the iterations, from where a damped motion comes to rest."""
        if (cluster := current()) is not None:
            self._require_room(cases, times)
            return OnCluster(self, cluster).ask("run", cases, times, instants=times)
        return self.led(cases, [Way(np.asarray(t, dtype=float)) for t in times])

    def led(self, cases: Sequence[Case], ways: Sequence[Way]) -> list[SimulatedMotion]:
        """Return the same motions, led where a way has a lead (fabdesign/nouns/lead.py)."""
        self._require_room(cases, times := [way.times for way in ways])
        if (cluster := current()) is not None:
            return OnCluster(self, cluster).ask("led", cases, ways, instants=times)
        motions = dict[int, SimulatedMotion]()
        with lock:
            for engine, approach, asked in self.tries(motions, len(cases)):
                steps = {i: engine.steps(cases[i], ways[i].times) for i in asked}
                for chunk in chunks_of(cases, self.points_per_side, {i: one.pattern for i, one in steps.items()}):
                    batch, still = engine.started(chunk, approach)
                    moved = engine.moved(batch, chunk, steps, ways)
                    for k, (i, motion) in enumerate(moved.items()):
                        lost = still is not None and not still[chunk.packed.index(k)]
                        motions[i] = replace(motion, diverged=(0.0, (0, 0))) if lost else motion
        return [motions[i] for i in range(len(cases))]

    sheets = run  # as fabdesign.geometry.shape asks for them: such a motion is one

    def started(self, chunk: Chunk, approach: Approach = Approach.USUAL) -> tuple[Batch, NDArray[np.bool_] | None]:
        """Return the chunk in the fields, at rest without pressure; and, where it may not have come there, (lanes,)
        whether it has."""
        start = equilibrium.start_of(chunk.cases[0], approach)
        batch = laid(
            chunk.damped() if start is equilibrium.Start.DAMPED else chunk, self.points_per_side, self.self_contact
        )
        for stage in equilibrium.to_start(batch, start, self.solve(batch), chunk.channels):
            advance(batch, *stage)
        if start is equilibrium.Start.DAMPED:
            specimens = [specimen_of(case) for case in chunk.lanes]
            put(batch.blocks, {"lane": constants_of(specimens, self.points_per_side)})
        return batch, equilibrium.rested(batch) if start is equilibrium.Start.CHECKED else None

    def moved(
        self, batch: Batch, chunk: Chunk, steps: Mapping[int, Steps], ways: Sequence[Way]
    ) -> dict[int, SimulatedMotion]:
        """Return the motions of a chunk in the fields, by the places of its cases. steps, ways: of all cases."""
        n, wanted = self.points_per_side, [steps[i] for i in chunk.places]
        schedule, begins = of_motions(batch, chunk.packed, wanted, tick=self.time_step, rho=self.rho)
        leads, lead = [ways[i].lead for i in chunk.places], None
        if any(leads):
            batch = replace(batch, added=every_force())
            instants = [one.evaluated(self.time_step, self.rho) for one in wanted]
            schedule.scheme[:, :, LED], lead = leading(batch.grid, chunk.packed, leads, instants)
        shapes, states = advance(batch, schedule, self.solve(batch), frames=int(begins[-1]), lead=lead)
        motions = {}
        for k, (i, case) in enumerate(zip(chunk.places, chunk.cases, strict=True)):
            frames = slice(begins[k], begins[k + 1])
            motions[i] = motion_of(case, ways[i].times, shapes[frames].reshape(-1, n, n, 3), states[frames])
        return motions

    def tries(
        self, results: Mapping[int, SimulatedMotion], count: int
    ) -> Iterator[tuple["Simulator", Approach, list[int]]]:
        """Yield all of the cases; then, finer and with patience, those whose result by then is lost."""
        yield self, Approach.USUAL, [*range(count)]
        if lost := [i for i in range(count) if results[i].diverged]:
            yield self.finer(), Approach.PATIENT, lost

    def steps(self, case: Case, times: Array, *, begin: int = 0, jumps: Jumps | None = None) -> Steps:
        """Return the steps of a motion with frames at `times` [s], from tick `begin` on. jumps: after which steps are
        short, by default those of the case's own pressures."""
        acting = self.acting(case, times)
        return self.steps_under(acting, times, jumps or self.jumps(case, acting), begin=begin)

    def acting(self, case: Case, times: Array) -> ActingPressure:
        """Return the pressures that act until the last of `times` [s]."""
        return acting_pressure(case, ticks_until(times, self.time_step), self.time_step)

    def jumps(self, case: Case, acting: ActingPressure) -> Jumps:
        """Return the jumps of the pressures that act in a case."""
        return jumps_of(acting.program, self.time_step, released=equilibrium.is_free(case.design.fabric))

    def steps_under(self, acting: ActingPressure, times: Array, jumps: Jumps, *, begin: int = 0) -> Steps:
        """Return the steps of a motion under pressures that act at least until the last of `times` [s]."""
        until = replace(acting, ticks=ticks_until(times, self.time_step))
        return steps_of(until, times, jumps, calm=self.calm, begin=begin)

    def _require_room(self, cases: Sequence[Case], times: Sequence[Array]) -> None:
        """Raise InputError where the motions, all together in memory, would take too much."""
        ends = [max(t[-1] if len(t) else 0.0, c.program.time[-1]) for c, t in zip(cases, times, strict=True)]
        channels = max((case.program.pressure.shape[1] for case in cases), default=0)
        require_motion(max(ends, default=0.0), sum(map(len, times)), self.points_per_side, channels=channels)

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        """Return (3362, 3) points [m] of each case at rest, as `rest` gives them."""
        if (cluster := current()) is not None:
            return OnCluster(self, cluster).equilibria(cases)
        return [shape.points[0] for shape in self.rest(cases)]

    def rest(self, cases: Sequence[Case]) -> list[SimulatedMotion]:
        """Return shapes at rest under each program's last pressures, as motions of one frame at 0 s with its tensions.
        The last step of a damped motion moved it by less than RESTED; NaN where no such shape was found, with half the
        steps and 2 s more neither."""
        if (cluster := current()) is not None:
            return OnCluster(self, cluster).ask("rest", cases)
        shapes: dict[int, SimulatedMotion] = {}
        with lock:
            for engine, approach, asked in self.tries(shapes, len(cases)):
                for chunk in chunks_of(cases, self.points_per_side, dict.fromkeys(asked, ())):
                    batch = engine._at_rest(chunk, approach)
                    middle, states = batch.positions(F.x0), batch.states()
                    middle[~equilibrium.rested(batch)] = np.nan
                    for k, (i, case) in enumerate(zip(chunk.places, chunk.cases, strict=True)):
                        lane = chunk.packed.index(k)
                        shapes[i] = motion_of(case, np.zeros(1), middle[lane : lane + 1], states[lane : lane + 1])
        return [shapes[i] for i in range(len(cases))]

    def shape_jacobian(self, cases: Sequence[Case], columns: Sequence[Column]) -> list[Jacobian]:
        """Return shapes at rest and how they change with each column (docs/model.md): by the tangent of the forces
        where that is positive definite, else by differences of shapes, which each Jacobian says (`exact`). Differences
        too for a free cloth, with self_contact, and where an effect adds a force. NaN where no shape was found."""
        solvable = [i for i, case in enumerate(cases) if not self.self_contact and _has_tangent(case)]
        solved = self._solve_shapes([cases[i] for i in solvable], columns) if solvable else []
        return self.shape_differences(cases, columns, dict(zip(solvable, solved, strict=True)))

    def shape_differences(
        self, cases: Sequence[Case], columns: Sequence[Column], solved: Mapping[int, Solved] = MappingProxyType({})
    ) -> list[Jacobian]:
        """Return the same by differences of shapes, but for what is `solved` already, by the case's place."""

        def shapes(moved: Sequence[Case]) -> list[NDArray[np.float32]]:
            return [shape.middle[0] for shape in self.rest(moved)]

        return completed(shapes, cases, columns, solved)

    def faces_jacobian(self, cases: Sequence[Case], columns: Sequence[Column]) -> list[FacesJacobian]:
        """Return the same of both faces' points, as `equilibria` gives them."""
        if (cluster := current()) is not None:
            return OnCluster(self, cluster).ask("faces_jacobian", cases, columns=columns)
        jacobians = self.shape_jacobian(cases, columns)
        return [faces_changes(one, case.design.fabric.thickness) for case, one in zip(cases, jacobians, strict=True)]

    def _solve_shapes(self, cases: Sequence[Case], columns: Sequence[Column]) -> list[Solved]:
        """Return each case's shape with those columns that the tangent gave."""
        solvable = [
            [c for c, column in enumerate(columns) if all(map(_has_tangent, move(case, column, column.step).sides))]
            for case in cases
        ]
        moved = MovedCases(cases, columns, self.points_per_side, self._at_rest_pressure)

        def solve(chunk: Chunk, lanes: Sequence[Share]) -> list[Solved]:
            return solve_at_rest(self._at_rest(chunk), [LaneColumns(*lane) for lane in lanes], moved)

        return self._solved(cases, solvable, solve)

    def _solved(self, cases: Sequence[Case], columns: Sequence[Sequence[int]], solve: Solves) -> list[Solved]:
        """Return what is solved of each case, whose `columns` lanes share: solve(chunk, the share of each lane)."""
        shares = share_out(columns)
        results: list[list[Solved]] = [[] for _ in cases]
        with lock:
            for chunk in chunks_of([cases[i] for i, _ in shares], self.points_per_side):
                for k, one in chunk.unpacked(solve(chunk, [shares[chunk.places[k]] for k in chunk.packed])):
                    results[shares[k][0]].append(one)
        return [together(parts) for parts in results]

    def balances(
        self, cases: Sequence[Case], courses: Sequence[Course], columns: Sequence[Column]
    ) -> list[list[Balance]]:
        """Return how frames of motions change with each column where forces balance with inertia and damping
        (sim/tangent/motion.py), at the instants of each case's course; NaN where no tangent is positive definite. A
        force that an effect adds is as the course has led to, and stays as it is."""
        if (cluster := current()) is not None:
            return OnCluster(self, cluster).ask("balances", cases, courses, columns=columns)
        frames = [(i, instant) for i, course in enumerate(courses) for instant in course.instants]
        until = max((instant.time for _, instant in frames), default=0.0)
        pressure = partial(pressures_until, until=until, tick=self.time_step)
        moved = MovedCases(cases, columns, self.points_per_side, pressure, courses=courses, tick=self.time_step)

        def solve(chunk: Chunk, lanes: Sequence[Share]) -> list[Solved]:
            states = [frames[k][1] for k, _ in lanes]
            of_lanes = [
                LaneColumns(frames[k][0], some, round(state.time / self.time_step), state.acceleration)
                for (k, some), state in zip(lanes, states, strict=True)
            ]
            return solve_in_motion(laid(chunk, self.points_per_side, False), of_lanes, moved, states)

        solved = self._solved([cases[i] for i, _ in frames], [range(len(columns))] * len(frames), solve)
        balances = iter(balance_of(one, len(columns)) for one in solved)
        return [[next(balances) for _ in course.instants] for course in courses]

    def _at_rest(self, chunk: Chunk, approach: Approach = Approach.USUAL) -> Batch:
        """Return the chunk in the fields, after a damped motion to rest under its last pressures."""
        batch = laid(chunk.damped(), self.points_per_side, self.self_contact)
        pressure = np.zeros((chunk.channels, len(chunk.packed)))
        for lane, case in enumerate(chunk.lanes):
            acting = self._at_rest_pressure(case)
            pressure[: len(acting), lane] = acting
        for stage in equilibrium.damped_motion(
            batch, by_block(pressure), self.solve(batch), rise=self.rise, hold=self.hold, approach=approach
        ):
            advance(batch, *stage)
        return batch

    def follow(self, case: Case, middle: NDArray[np.float32], *, steps: int = equilibrium.FOLLOWING) -> SimulatedMotion:
        """Go from a shape nearby, `middle` (n, n, 3) m, towards rest under the program's last pressures, as a motion of
        one frame: quick, and on the branch where `middle` is. Whether it has come to rest shows in how far another call
        moves it. Memory of forces stays at rest."""
        with lock:
            [chunk] = chunks_of([case], self.points_per_side)
            batch = laid(chunk.damped(), self.points_per_side, self.self_contact)
            put(batch.blocks, equilibrium.lying_at(batch, middle))
            pressure = by_block(np.repeat(self._at_rest_pressure(case)[:, None], len(chunk.packed), axis=1))
            for stage in equilibrium.long_steps(
                batch, pressure, self.solve(batch), ((equilibrium.FOLLOWING_STEP, steps),)
            ):
                advance(batch, *stage)
            return motion_of(case, np.zeros(1), batch.positions(F.x0)[:1], batch.states()[:1])

    def _at_rest_pressure(self, case: Case) -> Array:
        return equilibrium.pressure_at_rest(case, self.rise, self.hold)


def _has_tangent(case: Case) -> bool:
    """Return whether its shape at rest is where forces of positions alone balance."""
    return not equilibrium.is_free(case.design.fabric) and not has_added_force(case)
