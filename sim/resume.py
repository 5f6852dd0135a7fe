"""Motions that go on from a state in the midst of another: what acts later moves no earlier frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.forward import Case
from sim import state
from sim.chunks import Chunk, chunks_of, laid
from sim.kernels.fields import LANES, lock
from sim.kernels.transfer import Values, load, put, take
from sim.motion import SimulatedMotion, motion_of
from sim.simulator import Simulator
from sim.step import advance
from sim.time.batch import Batch
from sim.time.schedule import of_motions

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class State:
    """A motion at one instant: positions, velocities, accelerations, what its last step left, memory of forces."""

    tick: int  # of the simulator's time step
    values: Values  # by the name of a plane or an array, of one lane: (entries,), of vectors (entries, 3)


def at_rest(simulator: Simulator, case: Case) -> State:
    """Return where the case's motion starts."""
    with lock:
        chunk = _alone(case)
        batch, _ = simulator.started(chunk)
        return _state(batch, 0)


def go_on(
    simulator: Simulator, cases: Sequence[Case], states: Sequence[State], times: Sequence[Array]
) -> list[SimulatedMotion]:
    """Return the motions of cases from their states on, with frames at their `times` [s after rest, rising], which all
    lie after the state. A frame is the same, bit for bit, as in the motion from rest where that has a step's edge at
    the state's tick: one lies at every multiple of the simulator's `calm_steps`, jumps at such apart."""
    n, motions = simulator.points_per_side, dict[int, SimulatedMotion]()
    steps = {i: simulator.steps(case, times[i], begin=states[i].tick) for i, case in enumerate(cases)}
    with lock:
        for chunk in chunks_of(cases, n, {i: own.pattern for i, own in steps.items()}):
            batch = _resumed(simulator, chunk, [states[i] for i in chunk.places])
            schedule, begins = of_motions(
                batch, chunk.packed, [steps[i] for i in chunk.places], tick=simulator.time_step, rho=simulator.rho
            )
            shapes, tensions = advance(batch, schedule, simulator.solve(batch), frames=int(begins[-1]))
            for k, (i, case) in enumerate(zip(chunk.places, chunk.cases, strict=True)):
                frames = slice(begins[k], begins[k + 1])
                motions[i] = motion_of(case, times[i], shapes[frames].reshape(-1, n, n, 3), tensions[frames])
    return [motions[i] for i in range(len(cases))]


def with_states(
    simulator: Simulator, case: Case, begin: State, times: Array, ticks: Sequence[int]
) -> tuple[SimulatedMotion, list[State]]:
    """Return the same of one case, and its states at `ticks`, rising, all after the begin; `times` end there."""
    n, shapes, tensions, states = simulator.points_per_side, [], [], []
    with lock:
        batch = _resumed(simulator, _alone(case), [begin])
        before = begin.tick
        for tick in ticks:
            until = tick * simulator.time_step
            own = times[(times > before * simulator.time_step + 1e-9) & (times <= until + 1e-9)]
            steps = simulator.steps(case, np.append(own, until), begin=before)
            schedule, begins = of_motions(batch, [0] * LANES, [steps], tick=simulator.time_step, rho=simulator.rho)
            frames, state_of_muscles = advance(batch, schedule, simulator.solve(batch), frames=int(begins[-1]))
            shapes.append(frames[: len(own)].reshape(-1, n, n, 3))
            tensions.append(state_of_muscles[: len(own)])
            states.append(_state(batch, tick))
            before = tick
    return motion_of(case, times, np.concatenate(shapes), np.concatenate(tensions)), states


def _alone(case: Case) -> Chunk:
    return Chunk([0], [case], [0] * LANES)


def _resumed(simulator: Simulator, chunk: Chunk, states: Sequence[State]) -> Batch:
    """The chunk in the fields, each case in its state."""
    batch, contents = laid(chunk, simulator.points_per_side, simulator.self_contact)
    load(contents)
    lanes = [states[k] for k in chunk.packed]
    values = {}
    for name in _names():
        each = np.array([lane.values[name] for lane in lanes])
        values[name] = np.ascontiguousarray(np.moveaxis(each.reshape(batch.blocks, LANES, *each.shape[1:]), 1, -1))
    put(batch.blocks, values)
    return batch


def _state(batch: Batch, tick: int) -> State:
    """Of the first lane."""
    return State(tick, {name: value[0, ..., 0].copy() for name, value in take(batch.blocks, _names()).items()})


def _names() -> list[str]:
    carried = [plane.name for plane in state.PLANES if plane.life in (state.CARRIED, state.REMEMBERED)]
    return ["x0", *carried, *(own.name for own in state.ARRAYS if own.life == state.CARRIED)]
