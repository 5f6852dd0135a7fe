"""The devices of docs/lab/compiler.md, all on and all off: the same motions. Compiles all kernels twice."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from sim.kernels.frontend import HIDDEN_STEPS, SHORT_FRONTEND

ROOT = Path(__file__).parents[2]
MOTIONS = """
import sys
import numpy as np
from benchmarks.sim.cases import TIMES, reference
from sim import Simulator
np.save(sys.argv[1], np.array(Simulator(21).motions(reference(2), [TIMES[:18]] * 2)))
"""


def motions(out: Path, *off: str) -> np.ndarray:
    environment = os.environ | dict.fromkeys(off, "0") | {"FABDESIGN_LANES": "2"}
    subprocess.run([sys.executable, "-c", MOTIONS, str(out)], cwd=ROOT, env=environment, check=True, timeout=900)
    return np.load(out)


def test_the_same_motions(tmp_path, record):
    # m: rounding that 0.3 s of motion, with jumps of up to 400 kPa, lets grow; the cloth moves by 30 mm
    on, off = motions(tmp_path / "on.npy"), motions(tmp_path / "off.npy", SHORT_FRONTEND, HIDDEN_STEPS)
    assert np.abs(on - on[:, :1]).max() > 0.01
    apart = np.abs(on - off).max()
    record("motions without the devices of docs/lab/compiler.md", "5e-5 m", f"{apart:.1e} m")
    assert apart < 5e-5
