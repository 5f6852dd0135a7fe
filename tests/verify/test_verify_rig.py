"""Is the virtual rig, by which the simulator is judged, resolved itself?"""

import numpy as np
import pytest

from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.catalogue import build

pytest.importorskip("numba")

from studies.rig import GroundTruth
from studies.rig.scene import Resolution
from studies.rig.specimen import TrialTask, control_points, prepare


def test_default_elements_resolve_crossed_muscles(record):
    """Against elements of 6.7 mm; quadratic ones of 13.3 mm were 0.29 mm off."""
    times = np.arange(1, 6) / 30
    program = constant_program(np.array([150e3, 330e3]), times[-1])
    uv = 0.2 * np.stack(np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21)), axis=-1).reshape(-1, 2)

    def out_of_plane(resolution):
        task = TrialTask(build("cross"), program, times, 0, GroundTruth(), resolution)
        unit = prepare(task).patch.matrix(uv)
        return np.stack([(unit @ x)[:, 2] for x in control_points(task)])

    difference = out_of_plane(Resolution()) - out_of_plane(Resolution(element=0.2 / 30))
    miss = np.sqrt(np.square(difference).mean())
    record("virtual rig, default elements against 6.7 mm, out of plane", "0.15 mm RMS", f"{1e3 * miss:.3f} mm")
    assert miss < 0.15e-3
