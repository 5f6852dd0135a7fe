"""Which measurement would narrow a prediction most: expected information, linear and Gaussian.

About the model, shapes are linear in z, whose prior is the unit normal: a pose's shape is B z, a measurement's frames
are A z plus noise. After it z has covariance (1 + A^T A / noise^2)^-1, whatever is measured (Lindley 1956; Chaloner and
Verdinelli 1995), and the shape that times B on both sides.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.pressure import RigLimits
from fabdesign.study_files.unseen_file import CandidateMeasurement, Unsewn
from studies.tracing.experiment import programs
from studies.unseen.draws import Draws

Array = NDArray[np.float64]
STEP = 0.5  # of z, in differences
FRAMES = 6  # of a measurement
NOISE = 1e-3  # m a coordinate: the sensor's and what the model cannot follow
INDEPENDENT = 40  # points of a frame: what the model cannot follow is smooth over the cloth
_THIN = 8  # every so many-th point


def slopes(shapes: Sequence[NDArray[np.float32]]) -> Array:
    """Return (values, n) m by z, of shapes at +STEP and -STEP of each z in turn; every few points."""
    flat = [np.asarray(shape[..., ::_THIN, :], float).ravel() for shape in shapes]
    return np.stack([(up - down) / (2 * STEP) for up, down in zip(flat[::2], flat[1::2], strict=True)], axis=1)


def directions(count: int) -> list[Array]:
    """Return +STEP and -STEP of each z in turn."""
    return [sign * STEP * row for row in np.eye(count) for sign in (1, -1)]


def pose_slopes(unsewn: Unsewn, draws: Draws, forward: ForwardModel) -> Array:
    """Return (values, n) m: B, all poses one after another."""
    zs = directions(len(draws.names))
    cases = [draws.case(z, constant_program(pose)) for pose in unsewn.poses for z in zs]
    shapes = forward.equilibria(cases)
    return np.concatenate([slopes(shapes[k : k + len(zs)]) for k in range(0, len(shapes), len(zs))])


def information(candidates: Sequence[CandidateMeasurement], draws: Draws, forward: ForwardModel) -> list[Array]:
    """Return (n, n) A^T A / noise^2 of each candidate's motion; NaN where one diverged."""
    zs = directions(len(draws.names))
    cases = [draws.case(z, c.program, c.design) for c in candidates for z in zs]
    times = [c.program.duration * (np.arange(FRAMES) + 1) / FRAMES for c in candidates for _ in zs]
    motions = forward.motions(cases, times)
    matrices = []
    for k in range(0, len(motions), len(zs)):
        a = slopes(motions[k : k + len(zs)])
        points = len(a) / 3 / FRAMES
        matrices.append(a.T @ a * (INDEPENDENT / points) / NOISE**2)
    return matrices


def spread(b: Array, covariance: Array) -> float:
    """Return the RMS [m] over points, of shapes B z with z of this covariance."""
    return float(np.sqrt(3 * np.einsum("ij,jk,ik->i", b, covariance, b).mean()))


def after(b: Array, gained: Array) -> float:
    """Return the RMS [m] of what a measurement of this information leaves of the shapes' spread."""
    return spread(b, np.asarray(np.linalg.inv(np.eye(len(gained)) + gained)))


def in_turn(b: Array, gained: Mapping[str, Array], count: int) -> dict[str, float]:
    """Return at most `count` measurements, each the one that tells most beside those before it, and m RMS that they
    leave together. gained: (n, n), what `information` says of each."""
    chosen: dict[str, float] = {}
    known = np.zeros((b.shape[1], b.shape[1]))
    while len(chosen) < min(count, len(gained)):
        remaining = {name: after(b, known + information) for name, information in gained.items() if name not in chosen}
        best = min(remaining, key=lambda name: remaining[name])
        chosen[best], known = remaining[best], known + gained[best]
    return chosen


def candidates_of(unsewn: Unsewn, rig: RigLimits) -> list[CandidateMeasurement]:
    """Return the study's measurements; else steps, staircases and ramps on the design that the rig can do."""
    if unsewn.candidates:
        return [*unsewn.candidates]
    named = programs(unsewn.design, rig)
    return [CandidateMeasurement(name, unsewn.design, program) for name, program in named.items()]
