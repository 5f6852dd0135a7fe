"""Effects against the virtual rig's own code of the same laws: what an effect changes, there and here."""

import numpy as np
import pytest

from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram
from sim import Simulator

pytest.importorskip("numba")

from studies.rig import EffectSetting, GroundTruth
from studies.rig.scene import Resolution
from studies.rig.specimen import TrialTask, control_points, prepare

COARSE = Resolution(element=0.02, step=1 / 480)  # its own error is in both of its motions
SIMULATOR = Simulator(points_per_side=41)
DESIGN = build("side", muscles=4)
TIMES = np.arange(1, 17) / 40  # s
PROGRAM = PressureProgram(np.array([0.0, 0.2]), 1e3 * np.array([[150.0, 100, 50, 0], [60.0, 100, 120, 0]]), 0.4)
# what is not given has the default that both share
EFFECTS = {
    "threshold_pressure": {},
    "braid_hysteresis": {},
    "muscle_creep": {"share": 0.5, "time": 0.1},
    "muscle_viscosity": {"contracting": 40.0, "lengthening": 15.0},
    "stroke_softening": {},
    "odd_muscle": {},
    "filling_lag": {},
    "dead_time": {},
    "supply_droop": {},
    "line_loss": {},
    "orthotropy": {},
    "local_stiffening": {"u": 0.09, "v": 0.06, "radius": 0.04},
    "stress_relaxation": {"share": 0.4, "time": 0.1},
    "rest_curvature": {"across": 0.7, "down": 1.0, "twist": 0.5},
    "air_drag": {"coefficient": 60.0},
    "frame_tilt": {},
    "added_mass": {},
    "registration_bias": {"x": 0.001, "y": -0.002, "about_x": 1.0, "about_y": 2.0, "about_z": -1.5},
    "time_offset": {},
    "scale_error": {},
}
GRID = np.linspace(0.0, 0.2, 21)
ORDER = 4  # in the session


def of_the_rig(*effects):
    """(T, 21, 21, 3) m, mid-surface."""
    task = TrialTask(DESIGN, PROGRAM, TIMES, ORDER, GroundTruth(effects=effects), COARSE)
    uv, scene = np.stack(np.meshgrid(GRID, GRID), axis=-1).reshape(-1, 2), prepare(task)
    value = scene.patch.matrix(uv)
    points = np.array([value @ x for x in control_points(task)])
    for sense in scene.sensed:
        points = sense(points)
    return points.reshape(len(TIMES), 21, 21, 3)


def of_the_simulator(*terms):
    case = Case(DESIGN, PROGRAM, effects=terms, order=ORDER)
    [points] = Predictor(SIMULATOR, Model(), sensing=True).motions([case], [TIMES])
    return points.astype(float).reshape(len(TIMES), 2, 41, 41, 3).mean(axis=1)[:, ::2, ::2]


@pytest.fixture(scope="module")
def without():
    return of_the_rig(), of_the_simulator()


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_changes_what_it_changes_on_the_rig(name, without, record):
    values = EFFECTS[name]
    there = of_the_rig(EffectSetting(name, values)) - without[0]
    here = of_the_simulator(Term(name, values)) - without[1]
    size, apart = (1e3 * np.sqrt(np.square(x).sum(axis=-1).mean()) for x in (there, here - there))
    record(f"{name}, change against the synthetic rig's", "10 %", f"{apart / size:.1%} of {size:.2f} mm")
    assert apart < 0.1 * size
