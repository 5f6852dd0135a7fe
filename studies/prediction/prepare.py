"""Compile what the simulator and the distances are made of, once on a machine: parts side by side, each in a process of
its own. `python -m studies.prediction.prepare PART` compiles one."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from fabdesign.errors import SimulationError
from fabdesign.geometry.metrics import trial_errors
from fabdesign.geometry.sensor_noise import estimate_noise
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.column import Course, factor
from fabdesign.nouns.design import Term
from fabdesign.nouns.forward import Case, Instant
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.runtime.effort import cores

GRID = 21  # points a side; kernels are the same up to 41


def prepare(say: Callable[[str], None] = lambda _: None) -> float:
    """Compile every part, as many at once as there are cores. Returns the seconds that it took.

    Does no harm where all is compiled, or where another process compiles the same. Raises SimulationError.
    """
    begun = time.monotonic()
    seconds = 80 / min(cores(), 2)
    say(f"compiling the simulator, once on this machine: about {seconds:.0f} s (10 s where it is compiled)")
    with ThreadPoolExecutor(min(cores(), len(PARTS))) as pool:
        running = {pool.submit(_compile, part): part for part in PARTS}
        for done, ended in enumerate(as_completed(running), start=1):
            ended.result()
            say(f"compiled {done} of {len(PARTS)}: {running[ended]}")
    return time.monotonic() - begun


def _compile(part: str) -> None:
    command = [sys.executable, "-m", "studies.prediction.prepare", part]
    path = os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": path} | LANES.get(part, {})
    ended = subprocess.run(command, capture_output=True, text=True, env=environment)
    if ended.returncode:
        why = (ended.stderr.strip() or f"exit status {ended.returncode}").splitlines()[-1]
        raise SimulationError(f"compiling the {part} failed: {why}")


def _case(*effects: Term) -> Case:
    design = build("vertical")
    return Case(design, PressureProgram(np.zeros(1), np.full((1, design.channels), 50e3), 0.01), effects=effects)


def _motions(case: Case) -> None:
    from sim import Simulator

    Simulator(GRID).motions([case], [np.array([0.0, 0.01])])


def _derivatives() -> None:
    """Compile derivatives, of a frame of no motion: no motion is compiled for it."""
    from sim import Simulator

    nothing = np.zeros((GRID, GRID, 3))
    course = Course(np.zeros(1), nothing[None], [Instant(0.0, *[nothing] * 3, *[nothing[None]] * 3)])
    Simulator(GRID).balances([_case()], [course], [factor("membrane")])


def _distances() -> None:
    """Compile distances to points and to faces, of a cloud of a flat cloth."""
    across, down = np.meshgrid(np.linspace(-0.1, 0.1, GRID), np.linspace(-0.2, 0.0, GRID))
    face = np.stack([across, down, np.zeros_like(across)], axis=-1).reshape(-1, 3)
    shape = np.concatenate([face + [0, 0, 1e-3], face - [0, 0, 1e-3]])
    cloud = shape + np.random.default_rng(1).normal(0, 6e-4, shape.shape)
    trial_errors([cloud], shape[None], estimate_noise([cloud], 2e-3))


PARTS: dict[str, Callable[[], None]] = {  # the longest first
    "motions with effects": lambda: _motions(_case(Term("air_drag", {"coefficient": 3.0}))),
    "derivatives": _derivatives,
    "motions": lambda: _motions(_case()),
    "motions of a lone design": lambda: _motions(_case()),
    "distances": _distances,
}
LANES = {"motions of a lone design": {"FABDESIGN_LANES": "2"}}  # as `simulate` has them: kernels of their own

if __name__ == "__main__":
    PARTS[sys.argv[1]]()
