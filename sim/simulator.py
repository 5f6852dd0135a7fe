"""The public way in: a batch of cases becomes motions or equilibrium shapes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.forward import Case
from fabdesign.pressure import PressureProgram
from sim import fields
from sim.faces import faces
from sim.loading import load_batch
from sim.model import FREE, hung_code
from sim.scheme import MIDPOINT, Batch, Scheme
from sim.step import march, prepare
from sim.transfer import halt, muscle_state, read

Array = NDArray[np.float64]
BLOCKS = 8  # of LANES designs in the fields at once
REACH = 0.020  # m, half width over which the preconditioner's frames are averaged
AFTER_JUMP = ((16, 1), (128, 2))  # until so many ticks after a large jump, a step takes at most so many
LARGE = 50e3  # Pa, a jump that needs them
JUMP = 1e3  # Pa between one step and the next
# To rest: (step [s], steps) with backward Euler and so much air damping that a swing of SWING rad/s just dies out
SETTLE = ((1 / 960, 64), (1 / 480, 48), (1 / 240, 300))
RAMP = 64  # first steps in which the pressures rise to their values
SWING = 8.0  # rad/s
# To the shape without pressure, from the flat cloth: velocities are forgotten after each long step
HANG = ((0.05, 4), (0.5, 8))


@dataclass(frozen=True, eq=False)
class Motion:
    """One simulated motion. Frames after a divergence are NaN."""

    time: Array  # (T,) s after rest
    middle: NDArray[np.float32]  # (T, n, n, 3) m, mid-surface nodes, rows of rising v
    contraction: NDArray[np.float32]  # (T, intervals), muscle by muscle along its path
    tension: NDArray[np.float32]  # (T, intervals) N
    thickness: float  # m
    diverged: tuple[float, tuple[int, int]] | None  # time [s] of the first lost frame, and its (row, column)

    @property
    def points(self) -> NDArray[np.float32]:
        """(T, 3362, 3) m: front face, then back face, 41 x 41 each by rising v, then rising u."""
        return faces(self.middle, self.thickness)


@dataclass(frozen=True)
class Jumps:
    """Ticks in which a set point of a program moves by more than JUMP, and by more than LARGE; rest is at zero."""

    every: tuple[int, ...]
    large: tuple[int, ...]


@dataclass(frozen=True)
class Simulator:
    """Extended position-based dynamics of laced cloth (Macklin et al. 2016; docs/model.md), many designs at once.

    Implements fabdesign.forward.ForwardModel. Limits: muscles do not slip, the cloth does not touch itself, at most 8
    muscle types a batch.
    """

    points_per_side: int = 41
    time_step: float = 1 / 1920  # s, right after a jump of pressure; 2 in one for 67 ms
    calm_steps: int = 4  # time steps in one, later on
    iterations: int = 8  # at most, in a step
    tolerance: float = 1e-7  # m, RMS over nodes of the update that a step may still lack; the next step makes it up
    rho: float = 0.6  # spectral radius at infinity of generalised-alpha

    def __post_init__(self) -> None:
        if self.points_per_side < 9:
            raise InputError(f"points_per_side is {self.points_per_side}: expected at least 9")

    def motions(self, cases: Sequence[Case], times: Sequence[Array]) -> list[NDArray[np.float32]]:
        """(T, 3362, 3) points [m] of each case at its `times` [s after rest, rising]."""
        return [motion.points for motion in self.run(cases, times)]

    def run(self, cases: Sequence[Case], times: Sequence[Array]) -> list[Motion]:
        """Motions with mid-surfaces, contractions and tensions; each starts from equilibrium at zero pressure. One that
        diverges is tried once more with half the time step."""
        motions = self._run(cases, times)
        lost = [i for i, motion in enumerate(motions) if motion.diverged]
        if lost:
            finer = replace(self, time_step=self.time_step / 2)
            again = finer._run([cases[i] for i in lost], [times[i] for i in lost])
            for i, motion in zip(lost, again, strict=True):
                motions[i] = motion
        return motions

    def _run(self, cases: Sequence[Case], times: Sequence[Array]) -> list[Motion]:
        results: list[Motion | None] = [None] * len(cases)
        with fields.lock:
            jumps = [_jumps(case.program, self.time_step) for case in cases]
            for chosen in self._chunks(cases, jumps):
                batch = self._load([cases[i] for i in chosen])
                self._hang(batch, _channels(cases, chosen))
                for i, motion in zip(chosen, self._roll(batch, cases, times, chosen, jumps[chosen[0]]), strict=True):
                    results[i] = motion
        return [motion for motion in results if motion is not None]

    def equilibria(self, cases: Sequence[Case]) -> list[NDArray[np.float32]]:
        """(3362, 3) points [m] at rest under each program's last pressures; NaN where none was found."""
        results: list[NDArray[np.float32] | None] = [None] * len(cases)
        with fields.lock:
            for chosen in self._chunks(cases, [()] * len(cases)):
                batch = self._load([_damped(cases[i]) for i in chosen])
                pressure = _stack([cases[i].program.pressure[-1:] for i in chosen], batch.blocks)[0]
                self._settle(batch, pressure)
                middle = self._middle(batch)
                for lane, i in enumerate(chosen):
                    results[i] = faces(middle[lane : lane + 1], cases[i].design.fabric.thickness)[0]
        return [shape for shape in results if shape is not None]

    def _chunks(self, cases: Sequence[Case], jumps: Sequence[object]) -> list[list[int]]:
        """Indices in groups that one call can take: hung alike, pressures jumping in the same steps, so that a design's
        result does not depend on its neighbours, and BLOCKS x LANES designs at most."""
        groups: dict[tuple[int, object], list[int]] = {}
        for i, case in enumerate(cases):
            groups.setdefault((hung_code(case.design.fabric), jumps[i]), []).append(i)
        size = BLOCKS * fields.LANES
        return [group[k : k + size] for group in groups.values() for k in range(0, len(group), size)]

    def _load(self, cases: list[Case]) -> Batch:
        n = self.points_per_side
        spacing = max(case.design.fabric.height for case in cases) / (n - 1)
        hung = hung_code(cases[0].design.fabric)
        points = load_batch(cases, n, hung=hung, blocks=BLOCKS)
        blocks = -(-len(cases) // fields.LANES)
        return Batch(blocks, n, n, points, hung, max(1, round(REACH / spacing)))

    def _hang(self, batch: Batch, channels: int) -> None:
        """Equilibrium at zero pressure."""
        pressure = np.zeros((batch.blocks, channels, fields.LANES), np.float32)
        for h, steps in HANG:
            if batch.hung == FREE:  # nothing but inertia holds the rigid motions: float32 wants a share of it
                h = min(h, 1 / 30)
            prepare(batch, Scheme(h, -1.0))
            for _ in range(steps):
                march(
                    batch, [Scheme(h, -1.0)], pressure[None], iterations=2 * self.iterations, tolerance=self.tolerance
                )
                halt(*batch.grid)

    def _settle(self, batch: Batch, pressure: NDArray[np.float32]) -> None:
        """A damped motion to rest under `pressure`, which rises over the first RAMP steps."""
        taken = 0
        for h, steps in SETTLE:
            prepare(batch, Scheme(h, -1.0))
            share = np.minimum(1.0, (taken + 1 + np.arange(steps)) / RAMP).astype(np.float32)
            taken += steps
            march(
                batch, [Scheme(h, -1.0)] * steps, share[:, None, None, None] * pressure,
                iterations=2 * self.iterations, tolerance=self.tolerance / 4,
            )  # fmt: skip

    def _roll(
        self, batch: Batch, cases: Sequence[Case], times: Sequence[Array], chosen: list[int], jumps: Jumps
    ) -> list[Motion]:
        n, tick = self.points_per_side, self.time_step
        wanted = [np.asarray(times[i], dtype=float) for i in chosen]
        ticks = max([1, *(int(np.ceil(t[-1] / tick - 1e-6)) for t in wanted if len(t))])
        edges = step_edges(ticks, jumps.large, calm=self.calm_steps)
        instants = np.asarray(tick * edges, dtype=np.float64)
        program = _stack([step_pressures(cases[i].program, instants) for i in chosen], batch.blocks)
        middle = [np.full((len(t), n, n, 3), np.nan, np.float32) for t in wanted]
        muscle = [np.zeros((len(t), batch.points, 2), np.float32) for t in wanted]
        due = [np.clip(np.searchsorted(instants, t - 1e-9) - 1, 0, len(edges) - 2) for t in wanted]
        places = _frames_by_step(due)
        theta = np.zeros((batch.blocks, fields.LANES), np.float32)
        first = 0  # step that has not been taken
        schemes = self._schemes(edges, set(jumps.every))
        for k, begin in enumerate(edges[:-1]):
            h = schemes[k].h
            if k == 0 or h != schemes[k - 1].h:
                prepare(batch, schemes[k])
            if k in places or k + 1 == len(schemes) or schemes[k + 1].h != h:
                march(
                    batch, schemes[first : k + 1], program[first : k + 1],
                    iterations=self.iterations, tolerance=self.tolerance,
                )  # fmt: skip
                first = k + 1
            for frames in _layers(places.get(k, [])):
                for lane, frame in frames:
                    theta[divmod(lane, fields.LANES)] = np.clip((wanted[lane][frame] - begin * tick) / h, 0, 1)
                positions, state = self._middle(batch, h, theta), _muscle_state(batch)
                for lane, frame in frames:
                    middle[lane][frame] = positions[lane]
                    muscle[lane][frame] = state[lane]
        return [_motion(cases[i], t, m, s) for i, t, m, s in zip(chosen, wanted, middle, muscle, strict=True)]

    def _schemes(self, edges: NDArray[np.int_], jumps: set[int]) -> list[Scheme]:
        """The scheme of every step: the midpoint rule where a pressure jumps."""
        return [
            Scheme(float(end - begin) * self.time_step, MIDPOINT if jumps & set(range(begin, end)) else self.rho)
            for begin, end in pairwise(edges)
        ]

    def _middle(self, batch: Batch, h: float = 1.0, theta: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """(lanes, n, n, 3) at the fraction theta of the last step; its end by default."""
        n = self.points_per_side
        if theta is None:
            theta = np.ones((batch.blocks, fields.LANES), np.float32)
        out = np.empty((batch.blocks, fields.LANES, n * n, 3), np.float32)
        read(*batch.grid, h, theta, out)
        return out.reshape(-1, n, n, 3)


def step_edges(ticks: int, jumps: Sequence[int], *, calm: int) -> NDArray[np.int_]:
    """(steps + 1,) ticks between which steps lie: AFTER_JUMP says how long after each jump, `calm` ticks else."""
    longest = np.full(ticks + calm, calm)
    for jump in jumps:
        for until, most in reversed(AFTER_JUMP):
            longest[jump : jump + until] = np.minimum(longest[jump : jump + until], most)
    edges = [0]
    while edges[-1] < ticks:
        k = edges[-1]
        edges.append(k + next(c for c in sorted({calm, 2, 1}, reverse=True) if longest[k : k + c].min() >= c))
    return np.array(edges)


def step_pressures(program: PressureProgram, edges: Array) -> NDArray[np.float32]:
    """(steps, channels) Pa: the mean set point between every two of the instants `edges` (steps + 1,) s."""
    starts = np.asarray(program.time, dtype=float)
    pressure = np.asarray(program.pressure, dtype=float)
    # integral of the piecewise constant program from its first row on
    area = np.concatenate(
        [np.zeros((1, pressure.shape[1])), np.cumsum(pressure[:-1] * np.diff(starts)[:, None], axis=0)]
    )
    row = np.clip(np.searchsorted(starts, edges, side="right") - 1, 0, None)
    integral = area[row] + pressure[row] * (edges - starts[row])[:, None]
    return (np.diff(integral, axis=0) / np.diff(edges)[:, None]).astype(np.float32)


def _jumps(program: PressureProgram, tick: float) -> Jumps:
    last = int(np.ceil(program.time[-1] / tick)) + 2
    pressure = step_pressures(program, np.linspace(0.0, tick * last, last + 1))
    change = np.abs(np.diff(np.concatenate([np.zeros((1, pressure.shape[1])), pressure]), axis=0)).max(
        axis=1, initial=0
    )
    every, large = (tuple(int(k) for k in np.flatnonzero(change > least)) for least in (JUMP, LARGE))
    return Jumps(every, large)


def _damped(case: Case) -> Case:
    """The same equilibrium with critical air damping of a swing."""
    fabric = case.design.fabric
    drag = max(fabric.air_damping, 2 * SWING * fabric.areal_density)
    return replace(case, design=replace(case.design, fabric=replace(fabric, air_damping=drag)))


def _channels(cases: Sequence[Case], chosen: list[int]) -> int:
    return max(max(1, cases[i].program.pressure.shape[1]) for i in chosen)


def _stack(programs: list[NDArray], blocks: int) -> NDArray[np.float32]:
    """(steps, blocks, channels, LANES) Pa; lanes without a design repeat the last one."""
    steps, channels = programs[0].shape[0], max(max(1, p.shape[1]) for p in programs)
    out = np.zeros((steps, blocks, channels, fields.LANES), np.float32)
    for lane in range(blocks * fields.LANES):
        p = programs[min(lane, len(programs) - 1)]
        out[:, lane // fields.LANES, : p.shape[1], lane % fields.LANES] = p
    return out


def _frames_by_step(due: list[NDArray[np.int_]]) -> dict[int, list[tuple[int, int]]]:
    places: dict[int, list[tuple[int, int]]] = {}
    for lane, steps in enumerate(due):
        for frame, k in enumerate(steps):
            places.setdefault(int(k), []).append((lane, frame))
    return places


def _layers(places: list[tuple[int, int]]) -> list[list[tuple[int, int]]]:
    """Split so that a lane occurs once in each: a step may hold several frames of one motion."""
    layers: list[list[tuple[int, int]]] = []
    seen: dict[int, int] = {}
    for lane, frame in places:
        layer = seen.get(lane, 0)
        seen[lane] = layer + 1
        if layer == len(layers):
            layers.append([])
        layers[layer].append((lane, frame))
    return layers


def _muscle_state(batch: Batch) -> NDArray[np.float32]:
    out = np.zeros((batch.blocks, fields.LANES, max(batch.points, 1), 2), np.float32)
    if batch.points:
        muscle_state(batch.blocks, batch.points, out)
    return out[:, :, : batch.points].reshape(batch.blocks * fields.LANES, batch.points, 2)


def _motion(case: Case, time: Array, middle: NDArray[np.float32], state: NDArray[np.float32]) -> Motion:
    bad = ~(np.abs(middle) < 10.0)  # m; NaN compares false
    diverged = None
    if bad.any():
        first = int(np.argmax(bad.any(axis=(1, 2, 3))))
        row, column = np.argwhere(bad[first].any(axis=-1))[0]
        diverged = (float(time[first]), (int(row), int(column)))
        middle[first:], state[first:] = np.nan, np.nan
    own = [k for m in _spans(case) for k in m]
    return Motion(time, middle, state[:, own, 0], state[:, own, 1], case.design.fabric.thickness, diverged)


def _spans(case: Case) -> list[range]:
    """Indices of each muscle's intervals among all fixed points."""
    spans, start = [], 0
    for muscle in case.design.muscles:
        count = len(muscle.fixed_points())
        spans.append(range(start, start + count - 1))
        start += count
    return spans
