"""Targets that a known layout made on the virtual rig, and a half tube that none did."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.files.measurement_set import read_set
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import rising_program
from fabdesign.study_files.study_file import MuscleChoice
from optimize.search.margins import Limits
from optimize.search.starts import layout_starts
from studies.rig.cameras import measure
from studies.rig.motion import RigDiverged
from studies.rig.scene import Resolution
from studies.rig.specimen import GroundTruth, Sensing, TrialTask, control_points, prepare

RISE, HOLD = 1.0, 3.0  # s, of the motion to a target
ELEMENT, STEP = 0.01, 1 / 960  # m, s of the rig: coarser than its own, which costs far more
POINTS = 3362
# of copies with scatter, of which there are hundreds. Elements of 20 mm cost a tenth, but hold pairs of muscles 12 mm
# apart in one, and were 1.4 mm of Chamfer off on the nominal result of target 06
COPIES = Resolution(element=ELEMENT, step=1 / 240)
COPY_RISE, COPY_END = 0.5, 2.0  # s
POSES = 2


@dataclass(frozen=True)
class Truth:
    """A layout with its poses' pressures (poses, channels) Pa."""

    name: str
    design: Design
    pressures: NDArray[np.float64]

    @property
    def muscles(self) -> int:
        return len(self.design.muscles)


def truths() -> list[Truth]:
    """Twelve of 2 to 8 muscles: parallel and loose lines on one face and both, two with a corner, two of cloths that
    are not square. Each with two poses."""
    layouts = []
    for number, count in enumerate((2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 8)):
        cloth = build("vertical")
        if number in (4, 9):
            cloth = build("vertical", fabric=replace(cloth.fabric, width=0.3, height=0.18))
        [(space, x)] = layout_starts(cloth, Limits(), POSES, MuscleChoice(count, count), number=1, seed=number + 50)
        design, pressures = space.decode(x)
        if number in (2, 7):
            design = _bent(design)
        rng = np.random.default_rng(number)
        pressures = np.maximum(pressures, 150e3) * rng.uniform(0.6, 1.0, pressures.shape)
        kind = "bent" if number in (2, 7) else "drawn"
        layouts.append(Truth(f"{number:02d}_{count}_{kind}", replace(design, name=f"truth_{number:02d}"), pressures))
    return layouts


def _bent(design: Design) -> Design:
    """With a corner in its first muscle, a tenth of its length off the line."""
    first, *others = design.muscles
    a, b = np.array(first.path[0]), np.array(first.path[-1])
    along = b - a
    middle = (a + b) / 2 + 0.1 * np.array([-along[1], along[0]])
    size = np.array([design.fabric.width, design.fabric.height])
    u, v = np.clip(middle, 0.01, size - 0.01)
    bent = replace(first, path=(first.path[0], (float(u), float(v)), first.path[-1]))
    return replace(design, muscles=(bent, *others))


def measured(truth: Truth, pose: int, folder: Path) -> Path:
    """The cloud of a pose as the rig's sensor sees it at rest; made once."""
    from studies.rig import RigSession, run_rig

    file = folder / f"{truth.name}_{pose}.npz"
    if not file.is_file():
        out = folder / f"{truth.name}_{pose}"
        program = rising_program(truth.pressures[pose], RISE, RISE + HOLD)
        coarse = Resolution(element=ELEMENT, step=STEP)
        run_rig(RigSession([(truth.design, [program])], resolution=coarse), out, force=True)
        frames = read_set(out).trials[0].load().frames[-8:]
        points = np.concatenate(frames)
        np.savez(file, points=points[np.random.default_rng(pose).permutation(len(points))[:POINTS]])
    return file


def copy_on_rig(design: Design, pressures: NDArray[np.float64], number: int) -> NDArray[np.float64] | None:
    """(POINTS, 3) m of a copy under (channels,) Pa, in longer steps and sooner than a target; None where the rig has no
    solution."""
    program, times = rising_program(pressures, COPY_RISE, COPY_END), np.array([COPY_END])
    task = TrialTask(design, program, times, 0, GroundTruth(), COPIES)
    try:
        shape = control_points(task)[-1]
    except RigDiverged:
        return None
    return measure(prepare(task), shape, Sensing(points=POINTS), np.random.default_rng(number))


def half_tube(file: Path, *, width: float = 0.30, height: float = 0.18) -> Path:
    """A mesh (OBJ) of the cloth bent to half a tube about a horizontal axis, hung by its upper edge; m."""
    radius, across, down = height / np.pi, 31, 37
    u, v = np.meshgrid(np.linspace(0, width, across), np.linspace(0, height, down))
    points = np.stack([u - width / 2, -radius * np.sin(v / radius), radius * (1 - np.cos(v / radius))], axis=-1)
    corner = np.arange(across * down).reshape(down, across) + 1
    a, b, c, d = (x.ravel() for x in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
    faces = [*zip(a, c, b, strict=True), *zip(b, c, d, strict=True)]
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points.reshape(-1, 3)]
    file.write_text("\n".join([*lines, *(f"f {i} {j} {k}" for i, j, k in faces), ""]))
    return file
