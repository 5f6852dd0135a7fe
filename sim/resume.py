"""Motions that go on from a state in the midst of another: what acts later moves no earlier frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Case
from fabdesign.nouns.lead import Way
from sim import state as declared
from sim.chunks import Chunk, chunks_of, laid
from sim.kernels.fields import LANES, lock
from sim.kernels.transfer import Values, put, take
from sim.loading import by_blocks
from sim.motion import SimulatedMotion, motion_of
from sim.schedule import Batch, of_motions
from sim.simulator import Simulator
from sim.step import advance
from sim.time_steps import Jumps, together


@dataclass(frozen=True, eq=False)
class State:
    """A motion at one instant: positions, velocities, accelerations, what its last step left, memory of forces."""

    tick: int  # of the simulator's time step
    values: Values  # by the name of a plane or an array, of one lane: (entries,), of vectors (entries, 3)


def at_rest(simulator: Simulator, case: Case) -> State:
    """Return where the case's motion starts."""
    with lock:
        batch, _ = simulator.started(Chunk([0], [case], [0] * LANES))
        [state] = _states(batch, 0, 1)
        return state


def go_on(
    simulator: Simulator,
    cases: Sequence[Case],
    states: Sequence[State],
    times: Sequence[Array],
    *,
    jumps: Jumps | None = None,
) -> list[SimulatedMotion]:
    """Return the motions of cases from their states on, with frames at their `times` [s after rest, rising], which all
    lie after the state. A frame is the same, bit for bit, as in the motion from rest where that has a step's edge at
    the state's tick: one lies at every multiple of the simulator's `calm_steps`, jumps at such apart. jumps: after
    which the steps of all are short, by default each one's own."""
    motions = dict[int, SimulatedMotion]()
    steps = {i: simulator.steps(case, times[i], begin=states[i].tick, jumps=jumps) for i, case in enumerate(cases)}
    with lock:
        for chunk in chunks_of(cases, simulator.points_per_side, {i: one.pattern for i, one in steps.items()}):
            batch = _resumed(simulator, chunk, [states[i] for i in chunk.places])
            motions |= simulator.moved(batch, chunk, steps, [Way(each) for each in times])
    return [motions[i] for i in range(len(cases))]


@dataclass(frozen=True, eq=False)
class KeptMotion:
    """A motion with its states at some ticks; the jumps that its steps follow."""

    motion: SimulatedMotion
    states: list[State]
    jumps: Jumps


def with_states(
    simulator: Simulator,
    cases: Sequence[Case],
    begin: State,
    times: Array,
    ticks: Sequence[int],
    *,
    jumping: Sequence[int] = (),
) -> list[KeptMotion]:
    """Return the same of up to LANES cases of one design from one state, with their states at `ticks`, rising, all
    after the begin; `times` end there. They ride in one block, so that all take the same steps, short after each one's
    jumps. jumping: ticks at which pressures may jump, whose steps follow the midpoint rule, however small a jump is:
    motions that differ by a small one are then integrated alike."""
    if len(cases) > LANES:
        raise ValueError(f"{len(cases)} cases; expected at most {LANES}, those of one block")
    n, shapes, tensions = simulator.points_per_side, [], []
    states: list[list[State]] = [[] for _ in cases]
    end = np.array([ticks[-1] * simulator.time_step])
    acting = [simulator.acting(case, end) for case in cases]
    jumps = together([Jumps(tuple(jumping), ()), *map(simulator.jumps, cases, acting)])
    lanes = [min(k, len(cases) - 1) for k in range(LANES)]
    with lock:
        batch = _resumed(simulator, Chunk([*range(len(cases))], [*cases], lanes), [begin] * len(cases))
        before = begin.tick
        for tick in ticks:
            until = tick * simulator.time_step
            frames = times[(times > before * simulator.time_step + 1e-9) & (times <= until + 1e-9)]
            asked = np.append(frames, until)
            steps = [simulator.steps_under(one, asked, jumps, begin=before) for one in acting]
            schedule, begins = of_motions(batch, lanes, steps, tick=simulator.time_step, rho=simulator.rho)
            each, state_of_muscles = advance(batch, schedule, simulator.solve(batch), frames=int(begins[-1]))
            shapes.append(each.reshape(len(cases), len(asked), n, n, 3)[:, :-1])
            tensions.append(state_of_muscles.reshape(len(cases), len(asked), -1, 2)[:, :-1])
            for kept, state in zip(states, _states(batch, tick, len(cases)), strict=True):
                kept.append(state)
            before = tick
    middles, muscles = np.concatenate(shapes, axis=1), np.concatenate(tensions, axis=1)
    return [
        KeptMotion(motion_of(case, times, middle, muscle), one, jumps)
        for case, middle, muscle, one in zip(cases, middles, muscles, states, strict=True)
    ]


def _resumed(simulator: Simulator, chunk: Chunk, states: Sequence[State]) -> Batch:
    """Return the chunk in the fields, each case in its state."""
    batch = laid(chunk, simulator.points_per_side, simulator.self_contact)
    lanes = [states[k] for k in chunk.packed]
    put(batch.blocks, {name: by_blocks(np.array([lane.values[name] for lane in lanes])) for name in _names()})
    return batch


def _states(batch: Batch, tick: int, count: int) -> list[State]:
    """Return the states of the first `count` lanes of a batch of one block."""
    values = take(batch.blocks, _names())
    return [State(tick, {name: value[0, ..., k].copy() for name, value in values.items()}) for k in range(count)]


def _names() -> list[str]:
    carried = [plane.name for plane in declared.PLANES if plane.life in (declared.CARRIED, declared.REMEMBERED)]
    return ["x0", *carried, *(one.name for one in declared.ARRAYS if one.life == declared.CARRIED)]
