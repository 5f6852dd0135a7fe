"""Motions and shapes of designs: one, a batch, or a sweep into a table."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Unpack

from fabdesign.errors import InputError
from fabdesign.formats.result_tables import Columns, Tabled
from fabdesign.interface.run import Run, paths_of, simulator
from fabdesign.interface.verb import Computing, DesignLike, File, ModelLike, Npz, Pressures, Shown, verb

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from fabdesign.files.motion_file import Motion
    from fabdesign.nouns.design import Design
    from fabdesign.nouns.pressure import PressureProgram

FRAME_RATE = 60.0  # Hz, of the paper's cameras
_AT_ONCE = 64  # what the simulator takes side by side
LANES = "2"  # of kernels for a lone design: its motion takes a third less time


def _simulated(motion: Motion, given: Mapping[str, Any]) -> Shown:
    from fabdesign.files.motion_file import mesh_paths

    frames, (out, mesh) = len(motion.time), (given["out"], given["mesh"])
    meshes = {} if mesh is None else {"meshes": [str(file) for file in mesh_paths(mesh, frames)]}
    what = "the shape at rest," if given["equilibrium"] else f"{frames} frames of"
    content = {"motion": str(out), **motion.to_json(), **meshes}
    return Shown(content, f"{out}: {what} {motion.points.shape[1]} points")


@verb(_simulated, hidden=("cluster",), title="simulating")
def simulate(
    design: DesignLike | Sequence[DesignLike],
    pressures: Pressures = None,
    out: Npz | None = None,
    *,
    model: ModelLike | None = None,
    without: Sequence[str] = (),
    order: int = 0,
    duration: float | None = None,
    frame_rate: float = FRAME_RATE,
    equilibrium: bool = False,
    rise: float | None = None,
    hold: float | None = None,
    mesh: File | None = None,
    self_contact: bool = False,
    grid: int | None = None,
    **given: Unpack[Computing],
) -> Any:
    """Simulate the motion of a DESIGN under pressures.

    pressures: Pressures: a CSV, a trial's npz, or one constant row such as "400,0,200", in kPa, or "4bar,0,29psi".
    out: The npz to write: time, points.
    order: Place of the motion in the session; 0 is a rested specimen.
    duration: Duration of the motion, s; by default that of the pressures.
    frame_rate: Frames a second, Hz.
    equilibrium: One frame: the shape at rest under the last pressures.
    mesh: Write meshes too: NAME.ply or NAME.obj gives NAME_0000.ply, ..., a file per frame.
    self_contact: Layers of the cloth do not pass through each other; 5 to 8 times slower.

    A row of kPa, one for each channel, is held for 1.5 s. Several designs or pressures (one for each, or one for all)
    are a batch, and give a list of motions; after Ctrl-C those that are done, with a warning. Raises InputError for
    what does not fit together, SimulationError where a motion diverges. With `out`, of one design.

    >>> import fabdesign
    >>> motion = fabdesign.simulate(fabdesign.build("cross", muscles=2), [200, 0], duration=0.1, grid=21)
    >>> motion.time.shape, motion.faces.shape
    ((7,), (7, 2, 41, 41, 3))
    """
    from fabdesign.files.motion_file import mesh_paths, square_triangles, write_mesh, write_motion
    from fabdesign.files.pressure_file import note_slight
    from fabdesign.interface.arguments import pairs
    from fabdesign.nouns.forward import HOLD, RISE, Case
    from fabdesign.nouns.pressure import rising_program
    from studies.prediction.predict import frame_times, require_motions

    run, (asked, lone) = Run(**given), pairs(design, pressures)
    if equilibrium and duration is not None:
        raise InputError(f"--duration {duration:g}: a shape at rest has none; expected it without --equilibrium")
    if not equilibrium and (rise is not None or hold is not None):
        raise InputError("--rise and --hold: of a shape at rest; expected them with --equilibrium")
    if not lone and (out is not None or mesh is not None):
        raise InputError(f"{out or mesh}: one output for {len(asked)} motions; expected one design and one program")
    fitted = run.model(model, without)
    side = run.side(grid, fitted)
    times = [
        frame_times(p, duration=duration, frame_rate=frame_rate, points_per_side=side)
        for _, p in ([] if equilibrium else asked)
    ]
    meshes = [] if mesh is None else mesh_paths(Path(mesh), 1 if equilibrium else len(times[0]))
    rise, hold = RISE if rise is None else rise, HOLD if hold is None else hold
    acting = [rising_program(p.pressure[-1], rise, rise) if equilibrium else p for _, p in asked]
    inputs, names = paths_of(design, model, pressures), [each.name for each in meshes]
    first = meshes[0] if meshes else None
    with run.file(out, inputs) as file, run.file(first, inputs, names[1:]) as mesh_file, run.computing():
        if out is not None:
            os.environ.setdefault("FABDESIGN_LANES", LANES)  # read where the simulator is loaded for the first time
        run.warn_beyond(fitted, acting)
        forward = simulator(side, self_contact=self_contact, rise=rise, hold=hold)

        motions: list[Motion] = []
        try:
            for part in _parts(run, asked, "simulated"):
                cases = [Case(*pair, order=order) for pair in asked[part]]
                motions += require_motions(forward, cases, None if equilibrium else times[part], model=fitted)
        except KeyboardInterrupt:
            if not motions:
                raise
            run.say(f"interrupted, with the first {len(motions)} of {len(asked)} motions")
        if file is not None:
            write_motion(file, motions[0].time, motions[0].points, size=motions[0].size, muscles=motions[0].muscles)
        if mesh_file is not None:
            for name, frame in zip(names, motions[0].points, strict=True):
                write_mesh(mesh_file.with_name(name), frame, square_triangles(len(frame)))
    if lone and isinstance(pressures, Path | str):
        note_slight(float(asked[0][1].pressure.max(initial=0.0)), asked[0][0], str(pressures))
    return motions[0] if lone else motions


def equilibrium(
    design: DesignLike | Sequence[DesignLike],
    pressures: Pressures = None,
    *,
    model: ModelLike | None = None,
    without: Sequence[str] = (),
    order: int = 0,
    rise: float | None = None,
    hold: float | None = None,
    self_contact: bool = False,
    grid: int | None = None,
    **given: Unpack[Computing],
) -> Any:
    """Return the shape at rest after pressures [kPa of every channel] rose linearly: a motion of one frame; of several
    designs or pressures a list of them, in one batch.

    They rise in `rise` s, by default 1, and then hold for `hold` s, by default 10, where effects remember. Other
    arguments and errors are those of `simulate`.

    >>> import fabdesign
    >>> shape = fabdesign.equilibrium(fabdesign.build("vertical", muscles=2), [300, 300], grid=21)
    >>> bool(shape.faces[0, 0, -1, :, 2].mean() > 0.01)  # m: muscles in front pull the lower edge towards the viewer
    True
    """
    return simulate(
        design, pressures, model=model, without=without, order=order, equilibrium=True, rise=rise, hold=hold,
        self_contact=self_contact, grid=grid, **given,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Sweep(Tabled):
    """Numbers of many shapes. pressures: of each design, (channels,) kPa at the end. values: (n,) of each output.
    complete: False where it was interrupted."""

    designs: tuple[Design, ...]
    pressures: tuple[NDArray[np.float64], ...]
    values: Mapping[str, NDArray[np.float64]]
    complete: bool
    json_keys: ClassVar = ("**", lambda of: of.columns()), "complete"

    def __getitem__(self, output: str) -> NDArray[np.float64]:
        """Return (n,) of an output."""
        return self.values[output]

    def __len__(self) -> int:
        return len(self.designs)

    def columns(self) -> Columns:
        """Return design, muscles, the pressure of each channel [kPa], and the outputs."""
        import numpy as np

        channels = max((len(row) for row in self.pressures), default=0)
        padded = np.full((len(self), channels), np.nan)
        for row, kpa in zip(padded, self.pressures, strict=True):
            row[: len(kpa)] = kpa
        return {
            "design": [design.name for design in self.designs],
            "muscles": [len(design.muscles) for design in self.designs],
            **{f"channel_{k}_kpa": padded[:, k] for k in range(channels)},
            **self.values,
        }


def sweep(
    designs: DesignLike | Sequence[DesignLike],
    pressures: Pressures,
    outputs: Mapping[str, Callable[[Motion], float]],
    *,
    at: Sequence[float] = (),
    model: ModelLike | None = None,
    without: Sequence[str] = (),
    order: int = 0,
    rise: float | None = None,
    hold: float | None = None,
    grid: int | None = None,
    **given: Unpack[Computing],
) -> Sweep:
    """Return numbers of many shapes, a row for each design with its pressures: of shapes at rest, or of motions at the
    instants `at` [s].

    The outputs are functions of a motion, by name. Motions are not kept. One that cannot be computed gives NaN. Ctrl-C
    ends with the rows that are done. Other arguments and errors are those of `equilibrium`.

    >>> import fabdesign
    >>> cloth = fabdesign.build("vertical", muscles=2)
    >>> rows = [[100, 100], [300, 300]]  # kPa
    >>> outputs = fabdesign.sweep(cloth, rows, {"forward": lambda motion: motion.points[-1, :, 2].mean()}, grid=21)
    >>> bool(outputs["forward"][0] < outputs["forward"][1])
    True
    """
    import numpy as np

    from fabdesign.interface.arguments import functions_of, pairs
    from fabdesign.nouns.forward import HOLD, RISE, Case
    from fabdesign.units import in_kpa
    from studies.prediction.forward_model import forward_model, laced_motions

    run, functions = Run(**given), functions_of(outputs)
    asked, _ = pairs(designs, pressures)
    fitted = run.model(model, without)
    rows: list[list[float]] = []
    with run.computing():
        rise, hold = RISE if rise is None else rise, HOLD if hold is None else hold
        forward = simulator(run.side(grid, fitted), rise=rise, hold=hold)
        try:
            for part in _parts(run, asked, "swept"):
                cases, time = [Case(*pair, order=order) for pair in asked[part]], np.asarray(at, dtype=float)
                times = [time] * len(cases) if len(time) else None
                for motion in laced_motions(forward_model(forward, fitted), cases, times):
                    sound = np.isfinite(motion.points).all()
                    rows.append([float(function(motion)) if sound else np.nan for function in functions.values()])
        except KeyboardInterrupt:
            run.progress(f"interrupted, with {len(rows)} of {len(asked)} rows", len(rows) / len(asked))
    values = dict(zip(functions, np.array(rows).reshape(-1, len(functions)).T, strict=True))
    done = asked[: len(rows)]
    last = [in_kpa(program.pressure[-1]) for _, program in done]
    return Sweep(tuple(design for design, _ in done), tuple(last), values, len(rows) == len(asked))


def _parts(run: Run, asked: Sequence[tuple[Design, PressureProgram]], done: str) -> Iterator[slice]:
    """Give batches of what is asked for, each told once it is done; a lone one is told by its result."""
    from fabdesign.runtime.cluster import at_once

    size, total = at_once(_AT_ONCE), len(asked)
    for begin in range(0, total, size):
        yield slice(begin, begin + size)
        end = min(begin + size, total)
        if total > 1:
            run.progress(f"{done} {end} of {total} motions", end / total)
